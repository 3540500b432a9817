"""What the bench's camera sees before and after a level: the two pictures of a certificate."""

from pathlib import Path

from config.scene import Scene, Solver
from sim_core.report import Report
from sim_core.work_precision import with_setting

Pair = tuple[bytes, bytes]
"""Two JPEGs: the first picture of a test and its last."""


def before_and_after(scene: Scene, report: Report, path: Path) -> Pair | None:
    """The pictures of a level, or None where the scene has no camera.

    They are drawn from the same test, run once more at the setting that counted, and kept beside its result.

    Args:
        scene: the resolved scene at its level.
        report: the level's result.
        path: where that is kept.

    Raises:
        RefusedInput: the camera cannot see what it should.
    """
    if scene.camera is None:
        return None
    files = path.with_suffix(".before.jpg"), path.with_suffix(".after.jpg")
    try:
        return files[0].read_bytes(), files[1].read_bytes()
    except OSError:
        pass
    pair = _drawn(_as_it_counted(scene, report))
    for file, jpeg in zip(files, pair, strict=True):
        scratch = file.with_name(file.name + ".part")
        scratch.write_bytes(jpeg)
        scratch.replace(file)
    return pair


def _as_it_counted(scene: Scene, report: Report) -> Scene:
    numerics = report["numerics"]
    solver = Solver(
        engine=numerics["engine"], time_step_s=numerics["time_step_s"], iterations=numerics["iterations"]
    )
    return with_setting(scene)[0].model_copy(update={"solver": solver})


def _drawn(scene: Scene) -> Pair:
    from sim_core.camera.key_pictures import key_pictures
    from sim_core.camera.source import DrawnPictures
    from sim_core.camera.taker import ShotTaker
    from sim_core.run import run_test

    taker = ShotTaker(scene)
    run_test(scene, observers=[taker])
    source = DrawnPictures(scene)
    try:
        pictures = [source.picture(taker.shots[index]) for index in (0, -1)]
    finally:
        source.close()
    key = {shown.name: shown.jpeg for shown in key_pictures(pictures, [])}
    return key["start"], key["end"]
