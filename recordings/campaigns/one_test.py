"""One test of a campaign, from its scene to its bag and its label row, in any process on any machine."""

import errno
import hashlib
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from config.errors import PalletTwinError
from config.scene_file import scene_from_json
from recordings.campaigns.drafts import Factors
from recordings.campaigns.labels import Label, label_of
from recordings.recorded_test import recorded_test
from sim_core.companion import ErrorEstimate, answer_here, companion_scenes, compared
from sim_core.report import FAR_BEYOND, Report, full_report, worst_by_rule
from sim_core.work_precision import with_setting


@dataclass(frozen=True)
class Task:
    """What a worker is told.

    Attributes:
        number: of the draw.
        weight: see ``Label``.
        factors: what was drawn.
        scene_json: the resolved scene.
        with_estimate: whether the test is run again for its error estimate.
        with_pictures: False leaves the pictures out of the bag.
    """

    number: int
    weight: float
    factors: Factors
    scene_json: str
    with_estimate: bool = True
    with_pictures: bool = True


@dataclass(frozen=True)
class Cost:
    """What a test took; no two runs take the same, so it stands beside the label and not in it.

    Attributes:
        wall_s: wall time of all of it [s].
        process_s: processor time of all of it [s].
        test_s: wall time of the test with its pictures [s].
        estimate_s: wall time of the error estimate [s].
        worker: process that ran it.
    """

    wall_s: float
    process_s: float
    test_s: float
    estimate_s: float
    worker: str


@dataclass(frozen=True)
class Done:
    """A finished test: its label, its cost and the files of its bag by name; or the reason why there is none.

    ``has_no_room`` says that the reason is a full disk where the worker runs: nothing of the test's own.
    """

    number: int
    label: Label | None
    cost: Cost | None
    bag: Mapping[str, bytes]
    refused: str | None = None
    has_no_room: bool = False


def run_one(task: Task) -> Done:
    """Runs one test. What it leaves behind depends on the task alone."""
    began, began_process = time.perf_counter(), time.process_time()
    scene, why = with_setting(scene_from_json(task.scene_json))
    try:
        with tempfile.TemporaryDirectory(prefix="pallet-twin-") as scratch:
            # The bag's files carry the folder's name.
            folder = Path(scratch) / "bag"
            test = recorded_test(scene, bag=folder, with_camera=task.with_pictures)
            tested = time.perf_counter()
            estimate: ErrorEstimate | None = None
            if task.with_estimate and test.is_complete and scene.packages:
                answer = answer_here(companion_scenes(scene), enough_mm=_enough_mm(test.judged))
                estimate = compared(answer, scene, worst_by_rule(test.judged), test.smallest_step_s)
            files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    except PalletTwinError as error:
        return Done(task.number, None, None, {}, str(error))
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        return Done(
            task.number, None, None, {}, f"no space left in {tempfile.gettempdir()}", has_no_room=True
        )
    report = full_report(
        test.judged, scene, physics=test.result.physics, findings=test.result.findings, estimate=estimate,
        wall_s=test.result.wall_s, mode="campaign", why=why,
    )  # fmt: skip
    label = label_of(
        report,
        number=task.number,
        weight=task.weight,
        factors=task.factors,
        pictures=len(test.seen.pictures) if test.seen is not None else 0,
        judged=test.judged["verdict"],
        estimate_problem=estimate.problem if estimate is not None else None,
        bag_sha256=bag_digest(files),
        bag_bytes=sum(map(len, files.values())),
    )
    ended = time.perf_counter()
    cost = Cost(
        wall_s=ended - began,
        process_s=time.process_time() - began_process,
        test_s=tested - began,
        estimate_s=ended - tested,
        worker=f"{os.uname().nodename} {os.getpid()}",
    )
    return Done(task.number, label, cost, files)


def _enough_mm(judged: Report) -> float | None:
    """The peak at which a second run, too, has failed beyond doubt, where the first one has [mm]."""
    elastic = next((rule for rule in judged["rules"] if rule["rule"] == "elastic"), None)
    if elastic is None or elastic["worst_mm"] <= FAR_BEYOND * elastic["limit_mm"]:
        return None
    return float(FAR_BEYOND * elastic["limit_mm"])


def bag_digest(bag: Mapping[str, bytes]) -> str:
    """SHA-256 over the names and contents of a bag's files, in the names' order."""
    digest = hashlib.sha256()
    for name in sorted(bag):
        for part in (name.encode(), bag[name]):
            digest.update(len(part).to_bytes(8, "little"))
            digest.update(part)
    return digest.hexdigest()


@cache
def prepare_worker() -> None:
    """Makes a process ready for tests, once: one core's worth of threads, and no interrupts but the driver's."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "LP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    import cv2

    cv2.setNumThreads(1)
