"""One test from a scene to a folder with report, page and bag, in one process or as a node graph."""

import itertools
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from config.errors import EndedByMonitor, RefusedInput
from config.scene import Scene
from recordings.recorded_test import recorded_test
from sim_core.companion import Companion, CrossCheck, ErrorEstimate
from sim_core.integrity import require_integrity
from sim_core.report import Report, full_report, worst_by_rule, write_report
from sim_core.tolerance import run_to_tolerance
from sim_core.work_precision import with_setting

if TYPE_CHECKING:
    from sim_core.camera.source import Picture

RESULT_NAMES = {
    "bag", "report.json", "report.html", "video.mp4", "report.json.part", "report.html.part", "video.mp4.part",
}  # fmt: skip
OnProgress = Callable[[float, dict[str, str]], None]


@dataclass(frozen=True)
class TestFolder:
    """Where a test's results stand.

    Attributes:
        folder: the folder.
        report: ``report.json``.
        page: ``report.html``, or None when none was asked for.
        bag: the bag's directory, or None when nothing was recorded.
        video: the video of the scene's camera, or None when none is made.
    """

    __test__ = False

    folder: Path
    report: Path
    page: Path | None
    bag: Path | None
    video: Path | None = None


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
    video: Path | None = None,
) -> TestFolder:
    """Makes the folder of a test: ``out``, or the first free one of ``runs/NAME``, ``runs/NAME-2`` and so on.

    Raises:
        RefusedInput: the folder exists and is not empty, or cannot be made; a video of a scene without a camera.
    """
    if video is not None and scene.camera is None:
        raise RefusedInput("--video", str(video), "needs a camera in the scene, such as --set camera={}")
    if video is not None and video.suffix.lower() != ".mp4":
        raise RefusedInput("--video", str(video), "must end in .mp4")
    try:
        if bag is not None and (bag.is_file() or (bag.is_dir() and any(bag.iterdir()))):
            raise RefusedInput("--record", str(bag), "must be a new or an empty folder")
    except OSError as error:
        raise RefusedInput("--record", str(bag), error.strerror or "cannot be made") from None
    folder = claim_folder(out, scene.name, overwrite=overwrite)
    where = bag if bag is not None else folder / "bag"
    page = folder / "report.html" if with_page else None
    if video is None and scene.camera is not None:
        video = folder / "video.mp4"
    return TestFolder(folder, folder / "report.json", page, where if with_bag else None, video)


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
    # Pictures cost more than physics: none are taken of attempts that only look for the setting.
    is_planned = scene.camera is not None and scene.solver.tolerance_mm is not None
    attempt = partial(recorded_test, bag=where.bag, on_progress=on_progress)
    try:
        refined = run_to_tolerance(
            scene,
            partial(recorded_test, bag=None, with_camera=False, on_progress=on_progress)
            if is_planned
            else attempt,
            with_estimate=with_estimate,
        )
        last = attempt(refined.scene) if is_planned else refined.result
        result, judged = last.result, last.judged
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
    seen = last.seen
    if seen is not None:
        report |= {"vision": seen.measured} if seen.measured is not None else {}
        _write(report, refined.scene, where, seen.pictures, seen.drawn_by)
    else:
        _write(report, refined.scene, where)
    return TestOutcome(report, where, result.ended_by)


def run_graph(
    scene: Scene,
    where: TestFolder,
    *,
    pace: Literal["fast", "real"],
    discovery: Literal["localhost", "subnet"] = "localhost",
    with_estimate: bool = True,
    guests: int = 0,
    pictures: Path | None = None,
    with_view: bool = False,
    split: tuple[int, float] = (0, 0.0),
    bench: bool = False,
    classify: Path | None = None,
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
            scene,
            partial(recorded_test, bag=None, with_camera=False, on_progress=on_progress),
            with_estimate=with_estimate,
        )
        scene, estimate, why, refinements = planned.scene, planned.estimate, planned.why, planned.refinements
    else:
        scene, why = with_setting(scene)
    result = Supervisor(
        scene, pace, where.bag, on_progress, guests, pictures, with_view, split, bench, classify
    ).run()
    judged = json.loads(result.judgement_json)
    # What the machine did is not what a companion would repeat.
    if estimate is None and with_estimate and scene.packages and result.ended_by is None and not bench:
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
    if result.residual_json is not None:
        report["residual"] = json.loads(result.residual_json)
    if result.classified_json is not None:
        report["classifier"] = json.loads(result.classified_json)
    if result.measured_json is not None:
        report["vision"] = json.loads(result.measured_json)
    _write(report, scene, where, _recorded_pictures(scene, where.bag), "camera_node")
    return TestOutcome(report, where, result.ended_by)


def _recorded_pictures(scene: Scene, bag: Path | None) -> "list[Picture]":
    if scene.camera is None or bag is None:
        return []
    from recordings.bag_pictures import pictures_of_bag
    from recordings.bag_reader import BagReader
    from sim_core.camera.source import Picture

    with BagReader(bag) as reader:
        return [Picture(one.index, one.stamp_ns, jpeg=one.jpeg) for one in pictures_of_bag(reader)]


def _write(
    report: Report,
    scene: Scene,
    where: TestFolder,
    pictures: "Sequence[Picture]" = (),
    drawn_by: str = "",
) -> None:
    shown = None
    if pictures and scene.camera is not None:
        from sim_core.camera.key_pictures import key_pictures
        from sim_core.camera.moments import PictureMoments
        from sim_core.camera.view import camera_entry
        from sim_core.report_camera import ReportPictures

        report["camera"] = {**camera_entry(scene), "pictures": len(pictures), "drawn_by": drawn_by}
        video = None
        if where.video is not None:
            from sim_core.camera.video import write_video

            write_video(pictures, where.video, rate_hz=PictureMoments(scene).rate_hz)
            video = where.video.read_bytes()
        shown = ReportPictures(key_pictures(pictures, report["rules"]), video)
    write_report(report, where.report)
    if where.page is not None:
        from sim_core.report_html import write_report_html

        write_report_html(report, scene, where.page, pictures=shown)


def claim_folder(out: Path | None, name: str, *, overwrite: bool = False) -> Path:
    """Makes the folder ``out``, or the first free one of ``runs/NAME``, ``runs/NAME-2`` and so on.

    Raises:
        RefusedInput: the folder exists and is not empty, or cannot be made.
    """
    try:
        return _claim(out, overwrite) if out is not None else _claim_free(Path("runs") / name)
    except OSError as error:
        raise RefusedInput("--out", str(out or "runs"), error.strerror or "cannot be made") from None


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
