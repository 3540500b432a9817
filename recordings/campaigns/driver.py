"""Runs a campaign: hands out tests, keeps what comes back, goes on where it was left, and never counts half a test."""

import errno
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from config.campaign import Campaign
from config.errors import PalletTwinError, RefusedInput
from recordings.campaigns.balance import DrawOrder
from recordings.campaigns.drafts import Draft, Drafts
from recordings.campaigns.one_test import Done, Task
from recordings.campaigns.store import CampaignFolder
from recordings.campaigns.workers import Workers

WAIT_S = 0.5
RESERVE_BYTES = 2**30
"""Room that a campaign leaves on the disk."""
MOST_REFUSED = 20
"""A campaign of which so many draws make no test for every one that does is given up."""


class DiskFull(PalletTwinError):
    """A campaign that has no room for its next bag.

    Args:
        reason: what is full, and what to do.
    """

    exit_code = 3

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"stopped: {reason}; finished tests are whole, and the same command goes on with the rest"
        )


@dataclass(frozen=True)
class Standing:
    """How far a campaign is.

    Attributes:
        done: tests on disk.
        wanted: how many there will be.
        new: tests that this run has made.
        passes: tests that passed.
        fails: tests that failed.
        unresolved: tests that settle nothing.
        refused: draws that made no test.
        running: tests on the way.
        elapsed_s: since this run began [s].
        last: reason of the last refusal, or None.
    """

    done: int
    wanted: int
    new: int
    passes: int
    fails: int
    unresolved: int
    refused: int
    running: int
    elapsed_s: float
    last: str | None = None

    @property
    def rate_hz(self) -> float:
        """Tests a second in this run."""
        return self.new / self.elapsed_s if self.elapsed_s > 0.0 else 0.0

    @property
    def left_s(self) -> float | None:
        """How long the rest will take [s]; None while nothing is known."""
        return (self.wanted - self.done) / self.rate_hz if self.new else None


def run_campaign(
    campaign: Campaign,
    base: Path,
    folder: CampaignFolder,
    workers: Workers,
    *,
    at_most: int | None = None,
    on_progress: Callable[[Standing], None] | None = None,
) -> Standing:
    """Runs what is missing of a campaign, and writes its tables.

    Args:
        campaign: the campaign.
        base: folder that its palletising files are looked for in.
        folder: where its tests stand.
        workers: who runs them.
        at_most: only so many tests of it, the first ones; a later run goes on.
        on_progress: called whenever something has changed, and now and then.

    Raises:
        RefusedInput: no palletising file can be used, or there is no room on the disk.
        DiskFull: the room ended on the way.
    """
    drafts = Drafts(campaign, base)
    run = _Run(campaign, drafts, folder, workers, at_most, on_progress)
    try:
        run.all_rounds()
    finally:
        # Also what was done until an interrupt is in the tables.
        _write_tables(folder)
    return run.standing()


class _Run:
    def __init__(
        self,
        campaign: Campaign,
        drafts: Drafts,
        folder: CampaignFolder,
        workers: Workers,
        at_most: int | None,
        on_progress: Callable[[Standing], None] | None,
    ) -> None:
        self._campaign, self._drafts, self._folder, self._workers = campaign, drafts, folder, workers
        self._on_progress = on_progress
        planned = drafts.count if drafts.count is not None else (campaign.tests or 0)
        self._wanted = min(planned, at_most) if at_most is not None else planned
        self._began, self._new, self._running = time.monotonic(), 0, 0
        self._kept: list[int] = []
        self._last: str | None = None

    def all_rounds(self) -> None:
        """Round after round until all tests are there, or a list has no more."""
        order, is_checked = DrawOrder(self._drafts), False
        round_size = self._campaign.balance.round if self._campaign.balance is not None else self._wanted
        while len(self._kept) < self._wanted:
            labels = [self._folder.labels[number] for number in self._kept]
            numbers = order.round([(label.factors, label.success) for label in labels])
            size = min(round_size, self._wanted - len(self._kept))
            if not is_checked:
                self._require_room()
                is_checked = True
            made = self._round(numbers, size)
            self._kept += sorted(made)
            _write_tables(self._folder)
            if len(made) < size:
                break

    def standing(self) -> Standing:
        """How far it is."""
        labels = self._folder.labels.values()
        count = {
            wanted: sum(label.verdict == wanted for label in labels)
            for wanted in ("pass", "fail", "unresolved")
        }
        return Standing(
            done=len(self._folder.labels),
            wanted=self._wanted,
            new=self._new,
            passes=count["pass"],
            fails=count["fail"],
            unresolved=count["unresolved"],
            refused=len(self._folder.refused),
            running=self._running,
            elapsed_s=time.monotonic() - self._began,
            last=self._last,
        )

    def _round(self, numbers: Iterator[tuple[int, float]], size: int) -> set[int]:
        """The first so many draws that make tests; those on disk are not run again."""
        made: set[int] = set()
        on_the_way: dict[int, Draft] = {}
        is_over = False
        while len(made) < size and not (is_over and not on_the_way):
            while (
                not is_over and len(on_the_way) < self._workers.count and len(made) + len(on_the_way) < size
            ):
                drawn = next(numbers, None)
                if drawn is None:
                    is_over = True
                    break
                number, weight = drawn
                if number in self._folder.labels:
                    made.add(number)
                    continue
                if number in self._folder.refused:
                    continue
                draft = self._drafts.draft(number)
                if not isinstance(draft, Draft):
                    self._refuse(number, draft.factors, draft.reason)
                    continue
                on_the_way[number] = draft
                self._workers.submit(self._task(draft, weight))
            self._running = len(on_the_way)
            self._tell()
            for done in self._workers.finished(WAIT_S) if on_the_way else ():
                draft = on_the_way.pop(done.number)
                if done.has_no_room:
                    raise DiskFull(done.refused or "no space left")
                if done.refused is not None:
                    self._refuse(done.number, draft.factors, done.refused)
                    continue
                self._keep(done)
                made.add(done.number)
        return made

    def _task(self, draft: Draft, weight: float) -> Task:
        return Task(
            number=draft.number,
            weight=weight,
            factors=draft.factors,
            scene_json=draft.scene.to_json(),
            with_estimate=self._campaign.estimate,
            with_pictures=self._campaign.video == "pictures",
        )

    def _keep(self, done: Done) -> None:
        try:
            self._folder.keep(done)
        except OSError as error:
            raise _unwritable(self._folder, error) from None
        self._new += 1
        limit = 1.0e9 * self._campaign.disk_gb
        if self._folder.bag_bytes > limit:
            raise DiskFull(f"the bags take more than disk_gb = {self._campaign.disk_gb:g}; raise it")
        if shutil.disk_usage(self._folder.path).free < RESERVE_BYTES // 4:
            raise DiskFull(f"less than {RESERVE_BYTES / 4.0e9:.1f} GB left in {self._folder.path}")

    def _refuse(self, number: int, factors: "dict[str, object]", reason: str) -> None:
        self._folder.refuse(number, factors, reason)
        self._last = reason
        refused, made = len(self._folder.refused), len(self._kept) + self._new
        if self._drafts.count is None and refused > MOST_REFUSED * max(5, made):
            raise RefusedInput(
                "campaign", f"{refused} draws refused, {made} tests made", f"the last one: {reason}"
            )

    def _require_room(self) -> None:
        labels = self._folder.labels
        each = self._folder.bag_bytes / len(labels) if labels else _expected_bytes(self._drafts)
        needed = each * max(0, self._wanted - len(labels))
        total, free = needed + self._folder.bag_bytes, shutil.disk_usage(self._folder.path).free
        if total > 1.0e9 * self._campaign.disk_gb:
            raise RefusedInput(
                "disk_gb",
                self._campaign.disk_gb,
                f"at least {total / 1.0e9:.1f}, what about {self._wanted} tests take",
            )
        if needed + RESERVE_BYTES > free:
            raise RefusedInput(
                "--out", str(self._folder.path),
                f"needs about {needed / 1.0e9:.1f} GB, has {free / 1.0e9:.1f}; fewer tests, or video = recipe",
            )  # fmt: skip

    def _tell(self) -> None:
        if self._on_progress is not None:
            self._on_progress(self.standing())


def _write_tables(folder: CampaignFolder) -> None:
    try:
        folder.write_tables()
    except OSError as error:
        raise _unwritable(folder, error) from None


def _unwritable(folder: CampaignFolder, error: OSError) -> PalletTwinError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return DiskFull(f"no space left in {folder.path}")
    return RefusedInput("--out", str(folder.path), error.strerror or "cannot be written")


def _expected_bytes(drafts: Drafts) -> float:
    """What a bag takes, by the first test that can be made: poses and samples, film and pictures [bytes]."""
    last = min(50, drafts.count or 50)
    scene = next((made.scene for made in map(drafts.draft, range(last)) if isinstance(made, Draft)), None)
    if scene is None:
        return 0.0
    camera = scene.camera if drafts.campaign.video == "pictures" else None
    pictures = (
        0.3 * camera.width_px * camera.height_px * (camera.pictures or 4 * camera.rate_hz) if camera else 0.0
    )
    return 1.5e6 + pictures + (3.0e6 if scene.film is not None else 0.0)
