"""One test from a scene to a folder with report, page and bag, in one process or as a node graph."""

import itertools
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from config.errors import EndedByMonitor, RefusedInput
from config.scene import Scene
from sim_core.companion import Companion, CrossCheck, ErrorEstimate
from sim_core.integrity import require_integrity
from sim_core.report import Report, full_report, judgement, report_json, worst_by_rule, write_report
from sim_core.run import TestResult, run_test
from sim_core.tolerance import run_to_tolerance
from sim_core.work_precision import with_setting

RESULT_NAMES = {"bag", "report.json", "report.html", "report.json.part", "report.html.part"}
OnProgress = Callable[[float, dict[str, str]], None]


@dataclass(frozen=True)
class TestFolder:
    """Where a test's results stand.

    Attributes:
        folder: the folder.
        report: ``report.json``.
        page: ``report.html``, or None when none was asked for.
        bag: the bag's directory, or None when nothing was recorded.
    """

    __test__ = False

    folder: Path
    report: Path
    page: Path | None
    bag: Path | None


@dataclass(frozen=True)
class TestOutcome:
    """A finished test: its report, where it stands, and the monitor that ended it, if any."""

    __test__ = False

    report: Report
    where: TestFolder
    ended_by: EndedByMonitor | None


def make_folder(
    scene: Scene,
    out: Path | None,
    *,
    overwrite: bool,
    with_bag: bool,
    bag: Path | None = None,
    with_page: bool = True,
) -> TestFolder:
    """Makes the folder of a test: ``out``, or the first free one of ``runs/NAME``, ``runs/NAME-2`` and so on.

    Raises:
        RefusedInput: the folder exists and is not empty, or cannot be made.
    """
    try:
        if bag is not None and (bag.is_file() or (bag.is_dir() and any(bag.iterdir()))):
            raise RefusedInput("--record", str(bag), "must be a new or an empty folder")
        folder = _claim(out, overwrite) if out is not None else _claim_free(Path("runs") / scene.name)
    except OSError as error:
        raise RefusedInput("--out", str(out or "runs"), error.strerror or "cannot be made") from None
    where = bag if bag is not None else folder / "bag"
    page = folder / "report.html" if with_page else None
    return TestFolder(folder, folder / "report.json", page, where if with_bag else None)


@dataclass(frozen=True)
class _Attempt:
    """One run in this process with its judgement."""

    result: TestResult
    judged: Report

    @property
    def smallest_step_s(self) -> float:
        return self.result.physics.smallest_step_s

    @property
    def is_complete(self) -> bool:
        return self.result.ended_by is None


def run_headless(
    scene: Scene,
    where: TestFolder,
    *,
    with_estimate: bool,
    cross_check: bool = False,
    on_progress: OnProgress | None = None,
) -> TestOutcome:
    """Runs a test in this process, again at smaller steps where the scene's tolerance asks for it.

    Raises:
        RefusedInput: the load fails its integrity check, or a tolerance is to be kept without an estimate.
    """
    other = CrossCheck(with_setting(scene)[0]) if cross_check and scene.packages else None
    try:
        refined = run_to_tolerance(
            scene, partial(_attempt, bag=where.bag, on_progress=on_progress), with_estimate=with_estimate
        )
        result, judged = refined.result.result, refined.result.judged
        checked = other.compare(judged["rules"]) if other is not None else None
    except BaseException:
        if other is not None:
            other.cancel()
        raise
    report = full_report(
        judged, refined.scene, physics=result.physics, findings=result.findings, estimate=refined.estimate,
        wall_s=result.wall_s, mode="run", why=refined.why, refinements=refined.refinements,
    )  # fmt: skip
    if checked is not None:
        report["cross_check"] = checked
    _write(report, refined.scene, where)
    return TestOutcome(report, where, result.ended_by)


def _attempt(scene: Scene, *, bag: Path | None, on_progress: OnProgress | None) -> _Attempt:
    if bag is None:
        result = run_test(scene, on_progress=on_progress)
        return _Attempt(result, judgement(scene, result.judge, is_complete=result.ended_by is None))
    from recordings.test_bag import TestBag

    # What is there is a coarser attempt's.
    shutil.rmtree(bag, ignore_errors=True)
    with TestBag(bag, scene) as recording:
        result = run_test(scene, observers=[recording], on_progress=on_progress)
        judged = judgement(scene, result.judge, is_complete=result.ended_by is None)
        recording.finish(report_json(judged, compact=True))
    return _Attempt(result, judged)


def run_graph(
    scene: Scene,
    where: TestFolder,
    *,
    pace: Literal["fast", "real"],
    discovery: Literal["localhost", "subnet"] = "localhost",
    with_estimate: bool = True,
    guests: int = 0,
    on_progress: OnProgress | None = None,
) -> TestOutcome:
    """Runs a test as a node graph.

    The estimate's companion runs after it, so as not to slow the nodes. Where the scene asks for a tolerance, the step
    that keeps it is found first, in this process.

    Raises:
        RefusedInput: the load fails its integrity check, or a tolerance is to be kept without an estimate.
        NodeDied: a node ended before the test did; the bag until then is whole.
    """
    from ros_nodes.supervisor import Supervisor, configure_middleware

    findings = require_integrity(scene)
    configure_middleware(discovery)
    estimate: ErrorEstimate | None = None
    refinements: tuple[str, ...] = ()
    if scene.solver.tolerance_mm is not None:
        planned = run_to_tolerance(
            scene, partial(_attempt, bag=None, on_progress=on_progress), with_estimate=with_estimate
        )
        scene, estimate, why, refinements = planned.scene, planned.estimate, planned.why, planned.refinements
    else:
        scene, why = with_setting(scene)
    result = Supervisor(scene, pace, where.bag, on_progress, guests).run()
    judged = json.loads(result.judgement_json)
    if estimate is None and with_estimate and scene.packages and result.ended_by is None:
        companion = Companion(scene)
        try:
            estimate = companion.estimate(worst_by_rule(judged), result.physics.smallest_step_s)
        except BaseException:
            companion.cancel()
            raise
    report = full_report(
        judged, scene, physics=result.physics, findings=findings, estimate=estimate, wall_s=result.wall_s,
        mode=f"up {pace}", why=why, refinements=refinements,
    )  # fmt: skip
    if result.notes:
        report["numerics"]["pace"] = result.notes
    _write(report, scene, where)
    return TestOutcome(report, where, result.ended_by)


def _write(report: Report, scene: Scene, where: TestFolder) -> None:
    write_report(report, where.report)
    if where.page is not None:
        from sim_core.report_html import write_report_html

        write_report_html(report, scene, where.page)


def _claim(folder: Path, overwrite: bool) -> Path:
    if folder.exists() and not folder.is_dir():
        raise RefusedInput("--out", str(folder), "must be a folder")
    found = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
    if found and not overwrite:
        raise RefusedInput("--out", str(folder), "is not empty; choose another, or add --overwrite")
    if found - RESULT_NAMES:
        raise RefusedInput(
            "--out", str(folder), f"holds more than an earlier test: {sorted(found - RESULT_NAMES)[0]}"
        )
    for name in found:
        _remove(folder / name)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _claim_free(wanted: Path) -> Path:
    """The first of ``wanted``, ``wanted-2`` and so on that nobody else has; making it is what claims it."""
    wanted.parent.mkdir(parents=True, exist_ok=True)
    for number in itertools.count(1):
        folder = wanted if number == 1 else wanted.with_name(f"{wanted.name}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError("counting never ends")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
