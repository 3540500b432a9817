"""What running a campaign costs beside its tests: over their number, with one worker and several, and on Ray.

The same first tests are run by each kind of hands in turn, a few at a time, so that what else the machine does falls
on all of them alike.
"""

import hashlib
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from config.campaign import Campaign
from config.errors import RefusedInput
from recordings.campaigns.driver import run_campaign
from recordings.campaigns.store import CampaignFolder
from recordings.campaigns.workers import ProcessWorkers, Workers

STRETCH = 8
"""Tests that one kind of hands runs before the next has its turn."""


@dataclass(frozen=True)
class ScalingRow:
    """One kind of hands.

    Attributes:
        hands: who ran the tests.
        workers: how many at a time.
        tests: how many there were.
        wall_s: for all of them [s].
        first_half_s: of that for the first half [s].
        process_s: processor time of the tests themselves [s].
        first_half_process_s: of that for the first half [s].
        digests: of all bags together: equal for all hands.
    """

    hands: str
    workers: int
    tests: int
    wall_s: float
    first_half_s: float
    process_s: float
    first_half_process_s: float
    digests: str

    @property
    def beside(self) -> float:
        """Share of the workers' time that was not a test's."""
        return 1.0 - self.process_s / (self.workers * self.wall_s)

    @property
    def growth(self) -> float:
        """Wall time a processor second of the second half, over that of the first; 1 is linear."""
        second = (self.wall_s - self.first_half_s) / (self.process_s - self.first_half_process_s)
        return second / (self.first_half_s / self.first_half_process_s)


@dataclass
class _Turns:
    hands: str
    workers: Workers
    folder: CampaignFolder
    count: int
    wall_s: float = 0.0
    half_s: float = 0.0
    half_process_s: float = 0.0

    @property
    def process_s(self) -> float:
        return sum(cost.process_s for cost in self.folder.costs.values())


def measure_scaling(
    campaign: Campaign,
    base: Path,
    *,
    tests: int,
    workers: int,
    with_ray: bool,
    on_progress: Callable[[int, int, object], None] | None = None,
) -> list[ScalingRow]:
    """Runs the first tests of a campaign with one worker, with several, and on a Ray cluster of this machine.

    Args:
        campaign: the campaign.
        base: folder that its palletising files are looked for in.
        tests: how many of them, a multiple of 16.
        workers: how many at a time, where there are several.
        with_ray: whether Ray is tried too; it has to be installed.
        on_progress: called with tests done, how many there are, and who did the last ones.

    Raises:
        RefusedInput: the campaign cannot be run, or Ray is not there.
    """
    if campaign.tests is None or campaign.tests < tests:
        has = campaign.tests if campaign.tests is not None else "as many as its lists make"
        raise RefusedInput("--tests", tests, f"at most those of a random campaign; {campaign.name} has {has}")
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pallet-twin-scaling-")))
        hands: list[tuple[str, int, Callable[[], Workers]]] = [
            ("one process", 1, lambda: ProcessWorkers(1)),
            (f"{workers} processes", workers, lambda: ProcessWorkers(workers)),
        ]
        if with_ray:
            from recordings.campaigns.ray_workers import RayWorkers

            hands.append((f"Ray, {workers} processors", workers, lambda: RayWorkers(None, count=workers)))
        turns = []
        for number, (name, count, make) in enumerate(hands):
            folder = stack.enter_context(CampaignFolder(scratch / str(number), campaign))
            own = make()
            stack.callback(own.close)
            turns.append(_Turns(name, own, folder, count))
        _warm(campaign, base, scratch, turns)
        _take_turns(campaign, base, turns, tests, on_progress)
        return [_row(own, tests) for own in turns]


def _take_turns(
    campaign: Campaign,
    base: Path,
    turns: Sequence[_Turns],
    tests: int,
    on_progress: Callable[[int, int, object], None] | None,
) -> None:
    for last in range(STRETCH, tests + 1, STRETCH):
        for place, own in enumerate(turns):
            began = time.monotonic()
            run_campaign(campaign, base, own.folder, own.workers, at_most=last)
            own.wall_s += time.monotonic() - began
            if last == tests // 2:
                own.half_s, own.half_process_s = own.wall_s, own.process_s
            if on_progress is not None:
                done = (last - STRETCH) * len(turns) + STRETCH * (place + 1)
                on_progress(done, tests * len(turns), own.hands)


def _warm(campaign: Campaign, base: Path, scratch: Path, turns: Sequence[_Turns]) -> None:
    """Starts every worker with a test that doesn't count: imports and compiled kernels are paid for once."""
    for number, own in enumerate(turns):
        with CampaignFolder(scratch / f"warm-{number}", campaign) as folder:
            run_campaign(campaign, base, folder, own.workers, at_most=2 * own.count)


def _row(own: _Turns, tests: int) -> ScalingRow:
    labels = [own.folder.labels[number] for number in sorted(own.folder.labels)]
    digest = hashlib.sha256("".join(label.to_json() for label in labels).encode()).hexdigest()
    return ScalingRow(
        hands=own.hands,
        workers=own.count,
        tests=tests,
        wall_s=own.wall_s,
        first_half_s=own.half_s,
        process_s=own.process_s,
        first_half_process_s=own.half_process_s,
        digests=digest,
    )


def as_entry(row: ScalingRow, one: ScalingRow) -> dict[str, Any]:
    """A row with its ratios, for people and machines.

    Args:
        row: the row.
        one: that of one process.
    """
    return {
        **vars(row),
        "tests_a_minute": 60.0 * row.tests / row.wall_s,
        "times_one_process": one.wall_s / row.wall_s,
        "beside_the_tests": row.beside,
        "growth": row.growth,
        "same_bytes": row.digests == one.digests,
    }
