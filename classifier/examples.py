"""The settled tests of a campaign as examples to learn from, and their parting into training, validation and test."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from config.errors import RefusedInput
from recordings.campaigns.labels import Label
from recordings.campaigns.store import read_labels, test_folder

_PERMUTATIONS = 4000
"""That a split by scheme is chosen from."""


@dataclass(frozen=True)
class Example:
    """A test that passed or failed.

    Attributes:
        number: of the draw in its campaign.
        bag: directory of its recording.
        scheme: palletising scheme.
        success: whether it passed.
        label: all that is known of how it came out; nothing of it may reach the network's input.
    """

    number: int
    bag: Path
    scheme: str
    success: bool
    label: Label


@dataclass(frozen=True)
class Split:
    """Indices into a list of examples, ascending; every example is in one part.

    Attributes:
        train: what is learned from.
        validation: what ends the training and sets the temperature.
        test: what is only ever judged.
    """

    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]


def read_examples(folder: Path) -> list[Example]:
    """All settled tests of a campaign's folder, by number; those whose verdict is unresolved are left out.

    Args:
        folder: of a campaign, finished or not.

    Raises:
        RefusedInput: there is no campaign, or no settled test.
        BrokenRecording: a label is damaged.
    """
    found = [
        Example(
            label.number,
            test_folder(folder, label.number) / "bag",
            str(label.factors.get("scheme", "")),
            label.success,
            label,
        )
        for label in read_labels(folder)
        if label.success is not None
    ]
    if not found:
        raise RefusedInput("campaign", str(folder), "has no test yet that passed or failed beyond doubt")
    return found


def split_by_scheme(
    examples: Sequence[Example], *, seed: int, test_share: float = 0.2, validation_share: float = 0.1
) -> Split:
    """Parts examples so that no palletising scheme of the test part is in another part.

    Of many orders of the schemes, the one is taken whose cuts come closest to the shares and to the share of passed
    tests in all. Validation tests are drawn from all the other schemes: a tenth of all tests would be
    two schemes, and what is said of two schemes says little of others.

    Args:
        examples: what to part.
        seed: same seed and examples, same split.
        test_share: of all examples.
        validation_share: of all examples.

    Raises:
        RefusedInput: the shares leave nothing to train on, or there are fewer than three schemes.
    """
    _require_shares(test_share, validation_share)
    schemes = sorted({example.scheme for example in examples})
    if len(schemes) < 3:
        raise RefusedInput(
            "schemes", len(schemes), "must be at least 3, so that test and training have their own"
        )
    place = {scheme: index for index, scheme in enumerate(schemes)}
    counts = np.zeros((len(schemes), 2))
    for example in examples:
        counts[place[example.scheme], int(example.success)] += 1.0
    rng = np.random.default_rng(seed)
    best: tuple[float, NDArray[np.bool_]] | None = None
    for _ in range(_PERMUTATIONS):
        order = rng.permutation(len(schemes))
        # Cut in three, as before validation tests were drawn one by one: a seed's test part stays what it was.
        cut, cost = _cut(counts[order], (test_share, validation_share))
        if best is None or cost < best[0] - 1.0e-12:
            is_test = np.zeros(len(schemes), dtype=bool)
            is_test[order] = cut == 2
            best = cost, is_test
    assert best is not None
    passed = np.array([example.success for example in examples], dtype=bool)
    parts = np.array([2 if best[1][place[example.scheme]] else 0 for example in examples], dtype=np.intp)
    left = np.flatnonzero(parts == 0)
    share = min(validation_share * len(examples) / len(left), 0.5)
    for indices in (left[passed[left]], left[~passed[left]]):
        mixed = rng.permutation(indices)
        parts[mixed[: round(share * len(mixed))]] = 1
    return _split([int(part) for part in parts])


def split_at_random(
    examples: Sequence[Example], *, seed: int, test_share: float = 0.2, validation_share: float = 0.1
) -> Split:
    """Parts examples without regard to schemes; passed and failed tests are shared out alike.

    Args:
        examples: what to part.
        seed: same seed and examples, same split.
        test_share: of all examples.
        validation_share: of all examples.

    Raises:
        RefusedInput: the shares leave nothing to train on.
    """
    _require_shares(test_share, validation_share)
    rng = np.random.default_rng(seed)
    parts = np.zeros(len(examples), dtype=np.intp)
    passed = np.array([example.success for example in examples], dtype=bool)
    for indices in (np.flatnonzero(passed), np.flatnonzero(~passed)):
        mixed = rng.permutation(indices)
        tests, validations = round(test_share * len(mixed)), round(validation_share * len(mixed))
        parts[mixed[:tests]] = 2
        parts[mixed[tests : tests + validations]] = 1
    return _split([int(part) for part in parts])


def _cut(counts: NDArray[np.float64], shares: tuple[float, float]) -> tuple[NDArray[np.intp], float]:
    """Parts of schemes in a given order, first the test's, then validation's; and how far off they are.

    Args:
        counts: failed and passed tests of each scheme, shape [scheme_count, 2].
        shares: of test and validation.
    """
    total = counts.sum()
    gone = np.cumsum(counts.sum(axis=1)) / total
    # Each part gets at least one scheme.
    first = 1 + int(np.argmin(np.abs(gone[:-2] - shares[0])))
    second = first + 1 + int(np.argmin(np.abs(gone[first:-1] - gone[first - 1] - shares[1])))
    parts = np.zeros(len(counts), dtype=np.intp)
    parts[:first], parts[first:second] = 2, 1
    usual, cost = counts[:, 1].sum() / total, 0.0
    for part, share in ((2, shares[0]), (1, shares[1]), (0, 1.0 - sum(shares))):
        failed, passed = counts[parts == part].sum(axis=0)
        cost += abs((failed + passed) / total - share) / share + abs(passed / (failed + passed) - usual)
    return parts, float(cost)


def _require_shares(test_share: float, validation_share: float) -> None:
    for field, share in (("test_share", test_share), ("validation_share", validation_share)):
        if not 0.0 < share < 1.0:
            raise RefusedInput(field, share, "must be between 0 and 1")
    if test_share + validation_share >= 1.0:
        raise RefusedInput("test_share", test_share, f"leaves nothing to train on beside {validation_share}")


def _split(parts: Sequence[int]) -> Split:
    """From the part of each example: 0 training, 1 validation, 2 test."""
    train, validation, test = (
        tuple(index for index, part in enumerate(parts) if part == wanted) for wanted in range(3)
    )
    return Split(train, validation, test)
