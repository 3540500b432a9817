"""The optional parts of a test, and the ways of running a scene that have them on or off."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal

from config.camera import Camera
from config.errors import RefusedInput
from config.scene import Accelerometer, ForceFields, Sampling, Scene
from config.scene_file import validate_scene
from config.wrap import Wrap

Option = Literal["with_bag", "with_page", "with_estimate", "cross_check"]


def _nothing(_scene: Scene) -> object:
    return None


@dataclass(frozen=True)
class OptionalPart:
    """An optional part of a test; a new one is one entry in ``PARTS``.

    Attributes:
        name: short name, and the row's.
        words: what it is.
        key: the scene's field that it stands in, or None.
        on: that field's value where the part is on, from the user's scene.
        off: that field's value where it is off.
        option: the keyword of the run that turns it on, or None.
        needs: a package that must be installed, or None.
        imports: modules, with all below them, that must not be imported while it is off.
        enters: functions as ``module:name``, by how they begin, that must not be called while it is off.
        in_all: whether ``all`` has it.
    """

    name: str
    words: str
    key: str | None = None
    on: Callable[[Scene], object] = _nothing
    off: Callable[[Scene], object] = _nothing
    option: Option | None = None
    needs: str | None = None
    imports: tuple[str, ...] = ()
    enters: tuple[str, ...] = ()
    in_all: bool = True


def _denser_frames(scene: Scene) -> Sampling:
    rate = 2 * scene.sampling.poses_hz
    return scene.sampling.model_copy(update={"poses_hz": rate})


PARTS = (
    OptionalPart(
        "force_fields", "four force fields that hold the load",
        key="force_fields", on=lambda scene: scene.force_fields or ForceFields(),
        enters=("sim_core.force_fields:",),
    ),
    OptionalPart(
        "wrap", "film around the load, coupled both ways",
        key="wrap", on=lambda scene: scene.wrap or Wrap(material="stretch_film_20", turns=6.0),
        imports=("numba", "sim_core.wrap"), enters=("sim_core.wrap.",),
        # Fields stand for a wrap: both at once hold twice.
        in_all=False,
    ),
    OptionalPart(
        "accelerometer", "readings of the sled's accelerometer",
        key="accelerometer", on=lambda scene: scene.accelerometer or Accelerometer(),
        enters=("sim_core.run:Peekable.__next__",),
    ),
    OptionalPart(
        "camera", "pictures of 480 x 270, drawn, kept and made a video of",
        key="camera", on=lambda scene: scene.camera or Camera(width_px=480, height_px=270),
        imports=("cv2", "vtkmodules", "av", "sim_core.camera", "sim_core.vision"), enters=("sim_core.camera.",),
        # Pictures cost more than all else together.
        in_all=False,
    ),
    OptionalPart(
        "recording", "an MCAP bag of every message",
        option="with_bag",
        imports=("recordings.test_bag", "recordings.bag_writer", "msgs_adapters", "mcap", "zstandard"),
        enters=("recordings.test_bag:", "recordings.bag_writer:", "msgs_adapters."),
    ),
    OptionalPart(
        "report_page", "the report as a page with figures",
        option="with_page", imports=("matplotlib", "sim_core.report_html"), enters=("sim_core.report_html:",),
    ),
    OptionalPart(
        "error_estimate", "the same test at twice the step, on another core",
        option="with_estimate", enters=("sim_core.companion:Companion.", "sim_core.companion:companion_scenes"),
    ),
    OptionalPart(
        "cross_check", "the same test on the other engine, on another core",
        option="cross_check", needs="mujoco", enters=("sim_core.companion:CrossCheck.",),
    ),
    OptionalPart(
        "dense_frames", "twice the pose frames, each with its monitors and its judging",
        key="sampling", on=_denser_frames, off=lambda scene: scene.sampling, in_all=False,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Variant:
    """One way of running the scene: a row of the table.

    Attributes:
        name: the row's name.
        words: what it is.
        scene: the resolved scene, parts put in and taken out.
        parts: names of the parts that are on.
        options: keywords of the run that are on.
        loop_only: whether it is the loop written by hand, with no product around it.
    """

    name: str
    words: str
    scene: Scene
    parts: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    loop_only: bool = False


def variants(scene: Scene) -> tuple[list[Variant], dict[str, str]]:
    """The rows that a scene can have, and why the others are left out, by name.

    Args:
        scene: the user's resolved scene.
    """
    from sim_core.work_precision import with_setting

    # A row is one test: what a tolerance would choose is chosen here, for all rows alike.
    solver = with_setting(scene)[0].solver.model_copy(update={"tolerance_mm": None})
    scene = scene.model_copy(update={"solver": solver})
    bare = _changed(scene, {part.key: part.off(scene) for part in PARTS if part.key})
    rows = [
        Variant("bare_loop", "the loop written by hand: samples, physics, judge", bare, loop_only=True),
        Variant("bare", "a test without any optional part", bare),
    ]
    omitted: dict[str, str] = {}
    everything: list[OptionalPart] = []
    for part in PARTS:
        try:
            rows.append(_variant(part.name, part.words, scene, bare, [part]))
        except RefusedInput as refusal:
            omitted[part.name] = str(refusal)
            continue
        if part.in_all:
            everything.append(part)
    rows.append(
        _variant("all", "all of them: " + ", ".join(p.name for p in everything), scene, bare, everything)
    )
    return rows, omitted


def _variant(name: str, words: str, scene: Scene, bare: Scene, parts: list[OptionalPart]) -> Variant:
    for part in parts:
        if part.needs is not None and find_spec(part.needs) is None:
            raise RefusedInput(part.name, part.needs, "is not installed")
    return Variant(
        name,
        words,
        _changed(bare, {part.key: part.on(scene) for part in parts if part.key}),
        tuple(part.name for part in parts),
        tuple(part.option for part in parts if part.option is not None),
    )


def _changed(scene: Scene, values: Mapping[str, object]) -> Scene:
    """The scene with other parts; what does not fit together is refused."""
    return validate_scene(scene.model_copy(update=values).model_dump())
