"""What a campaign's tests are told apart by: drawn factors, values as they are and ranges in bins."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from config.campaign import Campaign, Range, Values
from recordings.campaigns.labels import Label

BINS = 4
"""Equal parts of a range; on a logarithmic range they are equal there."""
MOST_VALUES = 12
"""Whole numbers of a range up to so many stand for themselves."""
TITLES = {
    "all": "All tests",
    "scheme": "Palletising scheme",
    "layout": "Layout of the layers",
    "layers": "Layers",
    "restraint": "Restraint",
    "wrap.material": "Film",
    "sled.level_g": "Level [g]",
    "sled.direction": "Direction of travel",
    "sled.plateau_s": "Time at the level [s]",
    "sled.deceleration_g": "Braking [g]",
    "mass_factor": "Mass factor",
    "force_fields.tension": "Tension of the force fields",
    "wrap.turns.bottom": "Turns of film at the foot",
    "wrap.turns.middle": "Passes of film over the height",
    "wrap.turns.top": "Turns of film at the head",
    "wrap.pre_stretch": "Pre-stretch of the film",
    "wrap.wrap_force_n": "Wrapping force [N]",
}
_NO_FILM = "no film"
_ValueOf = Callable[[Label], str | None]


@dataclass(frozen=True)
class Group:
    """One way to tell tests apart.

    Attributes:
        key: factor, such as ``sled.level_g``.
        title: what a page calls it.
        values: those that tests have, in their order.
        value_of: value of a test; None where it has none.
    """

    key: str
    title: str
    values: tuple[str, ...]
    value_of: _ValueOf = field(repr=False, compare=False)

    def sorted_tests(self, labels: Sequence[Label]) -> list[tuple[str, list[Label]]]:
        """Each value with its tests; values without a test are left out."""
        found: dict[str, list[Label]] = {value: [] for value in self.values}
        for label in labels:
            value = self.value_of(label)
            if value is not None:
                found.setdefault(value, []).append(label)
        return [(value, own) for value, own in found.items() if own]


def campaign_groups(labels: Sequence[Label], campaign: Campaign) -> tuple[Group, ...]:
    """The groups of a campaign, all tests first.

    Args:
        labels: its tests.
        campaign: says what is drawn and from which ranges; where the camera stands is left out.
    """
    drawn, sled = _drawn(campaign), campaign.scene.get("sled")
    fixed = {f"sled.{key}": value for key, value in sled.items()} if isinstance(sled, dict) else {}
    fixed.setdefault("sled.direction", "+x")
    readers: dict[str, _ValueOf] = {
        "all": lambda _: "all",
        "scheme": lambda label: _words(label.factors.get("scheme")),
        "layout": lambda label: _words(label.factors.get("layout")),
        "layers": lambda label: _words(label.factors.get("layers")),
        "restraint": lambda label: _words(label.factors.get("restraint") or None),
        "wrap.material": lambda label: _film(label, campaign),
        "sled.level_g": _reader("sled.level_g", drawn.get("sled.level_g"), fixed.get("sled.level_g")),
        "sled.direction": _reader("sled.direction", drawn.get("sled.direction"), fixed["sled.direction"]),
    }
    for key, values in drawn.items():
        if key not in readers and not key.startswith("camera.") and not _is_vector(values):
            readers[key] = _reader(key, values, "none" if key in campaign.vary else None)
    known = {"layout": campaign.layouts, "restraint": tuple(entry.name for entry in campaign.restraints)}
    groups = []
    for key, value_of in readers.items():
        present = {value for label in labels if (value := value_of(label)) is not None}
        first = [value for value in known.get(key, ()) if value in present]
        if present:
            values_in_order = (*first, *sorted(present - set(first), key=_in_order))
            groups.append(Group(key, TITLES.get(key, _title(key)), values_in_order, value_of))
    return tuple(groups)


def bin_edges(values: Values) -> tuple[float, ...] | None:
    """Where a range's bins begin and end; None for a list and for a few whole numbers, which stand for themselves."""
    if not isinstance(values, Range) or isinstance(values.low, tuple) or isinstance(values.high, tuple):
        return None
    low, high = values.low, values.high
    if high <= low or (values.whole and high - low < MOST_VALUES):
        return None
    spaced = np.geomspace if values.scale == "log" else np.linspace
    edges = spaced(low, high, BINS + 1)
    # As short as they can be without two becoming one.
    for digits in (3, 6):
        rounded = tuple(float(f"{edge:.{digits}g}") for edge in edges)
        if all(one < other for one, other in pairwise(rounded)):
            return rounded
    return tuple(map(float, edges))


def _drawn(campaign: Campaign) -> dict[str, Values]:
    """Factors by the names that labels have, each with its values; those of several restraints are made one range."""
    found: dict[str, Values] = {f"friction {pair}": values for pair, values in campaign.friction.items()}
    found |= {"mass_factor": campaign.mass_factor} if campaign.mass_factor is not None else {}
    found |= campaign.vary
    for restraint in campaign.restraints:
        for key, values in restraint.vary.items():
            found[key] = _joined(found[key], values) if key in found else values
    return found


def _joined(one: Values, other: Values) -> Values:
    if isinstance(one, Range) and isinstance(other, Range) and not (_is_vector(one) or _is_vector(other)):
        ends = [end for values in (one, other) for end in (values.low, values.high)]
        low, high = min(map(_as_float, ends)), max(map(_as_float, ends))
        scale = "log" if one.scale == other.scale == "log" else "linear"
        return Range.model_validate(
            {"from": low, "to": high, "scale": scale, "whole": one.whole and other.whole}
        )
    # A list beside a range: bins hold both.
    return one if isinstance(one, Range) else other


def _reader(key: str, values: Values | None, default: object) -> _ValueOf:
    edges = bin_edges(values) if values is not None else None

    def value_of(label: Label) -> str | None:
        value = label.factors.get(key, default)
        if edges is None or isinstance(value, bool) or not isinstance(value, (int, float)):
            return _words(default if value is None else value)
        place = int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2))
        return f"{edges[place]:g} to {edges[place + 1]:g}"

    return value_of


def _film(label: Label, campaign: Campaign) -> str:
    """The film around the load, whether it was drawn by itself, with all of its wrap, or is the same for all."""
    wrap = label.factors.get("wrap", campaign.scene.get("wrap"))
    if isinstance(wrap, str) and wrap.startswith("{"):
        wrap = json.loads(wrap)
    fixed = wrap.get("material") if isinstance(wrap, dict) else None
    return str(label.factors.get("wrap.material", fixed) or _NO_FILM)


def _is_vector(values: Values) -> bool:
    return isinstance(values, Range) and isinstance(values.low, tuple)


def _as_float(number: float | tuple[float, ...]) -> float:
    assert not isinstance(number, tuple)
    return float(number)


def _words(value: object) -> str | None:
    """A value as tables show it."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return f"{value:g}"
    return json.dumps(value, separators=(",", ":"))


def _in_order(value: str) -> tuple[float, str]:
    """Numbers and bins by size, words behind them by the alphabet."""
    try:
        return float(value.split(" to ")[0]), value
    except ValueError:
        return math.inf, value


def _title(key: str) -> str:
    if key.startswith("friction "):
        return f"Friction {key.removeprefix('friction ').replace('/', ' on ')}"
    return key
