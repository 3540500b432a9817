"""Which draws become tests: all in turn, or those that bring about so many passes.

What would pass is guessed by a logistic regression of the outcomes so far on what was drawn. A draw with the chance p
is then taken with a probability in proportion to w(p) = a·p + 1 − p, with the a that is expected to bring the wanted
share. Among passes and among fails all draws stay as likely as they were, as far as p is right; and 1/w says how many
draws a test stands for, so rates over the campaign's own ranges can be had back. A round's choice depends on the
rounds before it alone, so it is the same however many workers there are.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from config.campaign import Campaign, Range
from recordings.campaigns.drafts import Drafts, Factors

LEAST_OUTCOMES = 20
_REFERENCE = 512
_RIDGE = 1.0
_STEPS = 25
Array = NDArray[np.float64]


class DrawOrder:
    """Gives the numbers of the draws that are to be tests, round by round.

    Args:
        drafts: the campaign's draws.
    """

    def __init__(self, drafts: Drafts) -> None:
        self._drafts, self._campaign = drafts, drafts.campaign
        self._features = _Features(drafts.campaign)
        self._next = 0

    def round(self, outcomes: Sequence[tuple[Factors, bool | None]]) -> Iterator[tuple[int, float]]:
        """Numbers with their weights, without end in a random campaign; the caller takes as many as it needs.

        A draw that is passed over is gone: the next round begins behind the last number that was given out.

        Args:
            outcomes: factors and success of all tests so far, in their order; None for an unresolved one.
        """
        chance = self._chance(outcomes)
        while self._drafts.count is None or self._next < self._drafts.count:
            number, self._next = self._next, self._next + 1
            if chance is None:
                yield number, 1.0
                continue
            factors = self._drafts.factors(number)
            wanted, most = chance.wanted(factors)
            if np.random.default_rng((self._campaign.seed, 1, number)).random() < wanted / most:
                yield number, 1.0 / wanted

    def _chance(self, outcomes: Sequence[tuple[Factors, bool | None]]) -> "_Tilt | None":
        balance = self._campaign.balance
        settled = [(factors, success) for factors, success in outcomes if success is not None]
        if balance is None or self._campaign.tests is None or len(settled) < LEAST_OUTCOMES:
            return None
        passes = sum(success for _, success in settled)
        if passes in (0, len(settled)):
            return None
        share_settled = len(settled) / len(outcomes)
        left = max(1.0, share_settled * (self._campaign.tests - len(outcomes)))
        total = len(settled) + left
        share = float(np.clip((balance.success_share * total - passes) / left, 0.02, 0.98))
        features = np.array([self._features.of(factors) for factors, _ in settled])
        model = _Logistic(features, np.array([success for _, success in settled], dtype=float))
        reference = np.array([self._features.of(self._drafts.factors(k)) for k in range(_REFERENCE)])
        return _Tilt(self._features, model, model.chance(reference), share)


class _Tilt:
    """How much more often a draw is taken than another, by its chance to pass."""

    def __init__(self, features: "_Features", model: "_Logistic", natural: Array, share: float) -> None:
        self._features, self._model = features, model
        low, high = np.log(1.0e-3), np.log(1.0e3)
        for _ in range(60):
            middle = 0.5 * (low + high)
            weights = np.exp(middle) * natural + 1.0 - natural
            low, high = (middle, high) if (weights * natural).sum() < share * weights.sum() else (low, middle)
        self._favour = float(np.exp(0.5 * (low + high)))
        # On average a test stands for one draw.
        self._scale = float(np.mean(self._favour * natural + 1.0 - natural))

    def wanted(self, factors: Factors) -> tuple[float, float]:
        """Weight of a draw, and the largest that there is."""
        chance = float(self._model.chance(self._features.of(factors)[None])[0])
        weight = (self._favour * chance + 1.0 - chance) / self._scale
        return weight, max(self._favour, 1.0) / self._scale


class _Features:
    """Factors as numbers: ranges centred, on their own scale; lists as one column an entry."""

    def __init__(self, campaign: Campaign) -> None:
        self._ranges: dict[str, tuple[Any, bool]] = {}
        self._choices: dict[str, dict[str, int]] = {}
        restraints = {restraint.name: restraint for restraint in campaign.restraints}
        named = [(key, values) for key, values in campaign.vary.items()]
        named += [(f"friction {pair}", values) for pair, values in campaign.friction.items()]
        named += [("mass_factor", campaign.mass_factor)] if campaign.mass_factor is not None else []
        named += [pair for restraint in restraints.values() for pair in restraint.vary.items()]
        for key, values in named:
            # Where the camera stands decides nothing.
            if key.startswith("camera."):
                continue
            if isinstance(values, Range) and not isinstance(values.low, tuple):
                self._ranges[key] = values, values.scale == "log"
            elif not isinstance(values, Range) and all(_is_number(value) for value in values):
                numbers = [float(value) for value in values]  # type: ignore[arg-type]
                self._ranges[key] = Range.model_validate({"from": min(numbers), "to": max(numbers)}), False
            elif not isinstance(values, Range):
                self._choices[key] = _places(map(str, values))
        self._choices["scheme"] = _places(load.scheme_name for load in campaign.loads)
        self._choices["layout"] = _places(campaign.layouts)
        self._choices["restraint"] = _places(restraints)

    def of(self, factors: Factors) -> Array:
        """The features of one draw, with a leading 1."""
        found = [1.0, 0.2 * (float(factors["layers"]) - 5.0)]
        for key, (values, is_log) in self._ranges.items():
            value = factors.get(key)
            found.append(0.0 if value is None else _centred(float(value), values.low, values.high, is_log))
        # A level weighs more the less there is to hold the load.
        level = found[2 + list(self._ranges).index("sled.level_g")] if "sled.level_g" in self._ranges else 0.0
        found += [level * value for value in found[2:]]
        for key, places in self._choices.items():
            columns = [0.0] * len(places)
            place = places.get(str(factors.get(key)))
            if place is not None:
                columns[place] = 1.0
            found += columns
        return np.array(found)


class _Logistic:
    """Logistic regression with a ridge, by Newton steps (Hastie, Tibshirani, Friedman, section 4.4.1)."""

    def __init__(self, features: Array, success: Array) -> None:
        self._weights = np.zeros(features.shape[1])
        ridge = _RIDGE * np.eye(features.shape[1])
        ridge[0, 0] = 1.0e-6
        for _ in range(_STEPS):
            chance = self.chance(features)
            slope = features.T @ (success - chance) - ridge @ self._weights
            curve = (features * (chance * (1.0 - chance))[:, None]).T @ features + ridge
            step = np.linalg.solve(curve, slope)
            self._weights += step
            if np.abs(step).max() < 1.0e-9:
                break

    def chance(self, features: Array) -> Array:
        """Chance to pass, shape [n]."""
        chance: Array = 1.0 / (1.0 + np.exp(-np.clip(features @ self._weights, -30.0, 30.0)))
        return chance


def _places(names: Iterable[str]) -> dict[str, int]:
    """A column for each name; loads of one scheme share one, and a list may say a value twice to weigh it."""
    return {name: place for place, name in enumerate(dict.fromkeys(names))}


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _centred(value: float, low: float, high: float, is_log: bool) -> float:
    if high <= low:
        return 0.0
    if is_log:
        value, low, high = np.log(value), np.log(low), np.log(high)
    return float(2.0 * (value - low) / (high - low) - 1.0)
