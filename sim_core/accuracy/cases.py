"""The reference suite: scenes whose outcome is known, what is measured on them, and how far off it may be."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from config.scene import Scene
from sim_core.accuracy.closed_forms import (
    field_motion_m,
    pushed_slides_m,
    slab_slips_m,
    tipping_level_g,
    trapezoid_slip_m,
    trapezoid_travel_m,
)
from sim_core.frames import GRAVITY, Array, PoseFrame
from sim_core.judge import EumosJudge

RawScene = dict[str, Any]
ReferenceKind = Literal["closed form", "own ODE", "zero", "self-refined"]
SceneKind = Literal["sliding", "impact", "resting", "threshold", "wrapped", "pressed"]

POSES_HZ = 240
"""Pose frames a second of every case, where the step allows it."""
BAR_RELATIVE, BAR_MM = 5.0e-4, 0.1
"""What the product promises at its default setting: 0.05 % or 0.1 mm, whichever is larger."""


@dataclass(frozen=True)
class Track:
    """What one run left behind.

    Attributes:
        scene: the scene that ran.
        frames: its pose frames, in frame ``sled``.
    """

    scene: Scene
    frames: tuple[PoseFrame, ...]

    def moved_mm(self, row: int, axis: int = 0) -> Array:
        """Displacement of a body's centre along an axis since the first frame [mm], shape [frame_count].

        Args:
            row: the body, 0 is the pallet.
            axis: 0 for x, 1 for y, 2 for z.
        """
        places = np.array([frame.positions[row, axis] for frame in self.frames])
        moved: Array = 1000.0 * (places - places[0])
        return moved

    def judge(self) -> EumosJudge:
        """A judge that has taken every frame."""
        judge = EumosJudge(self.scene)
        for frame in self.frames:
            judge.add(frame)
        return judge

    def peak_mm(self) -> float:
        """Largest displacement of any corner of any package since the first frame [mm]."""
        return max(package.peak_mm for package in self.judge().packages())


@dataclass(frozen=True)
class Quantity:
    """One number that a case is measured by.

    Attributes:
        name: such as ``slip``.
        reference: the right value, in ``unit``.
        kind: where the reference comes from.
        unit: ``mm``, ``s``, or ``g`` for a threshold, whose error is given relative to the reference.
        allowed: an error that is small enough, in the unit of ``error``; None for the product's promise.
    """

    name: str
    reference: float
    kind: ReferenceKind
    unit: Literal["mm", "s", "g"] = "mm"
    allowed: float | None = None

    def error(self, measured: float) -> float:
        """|measured − reference| in ``unit``; relative to the reference for a threshold."""
        difference = abs(measured - self.reference)
        return difference / abs(self.reference) if self.unit == "g" else difference

    @property
    def bar(self) -> float:
        """The error that is small enough, in the unit of ``error``."""
        if self.allowed is not None:
            return self.allowed
        return BAR_RELATIVE if self.unit == "g" else max(BAR_MM, BAR_RELATIVE * abs(self.reference))


RunScene = Callable[[RawScene, float | None], Track]
"""Runs a scene with the settings under test until a time [s], or until its end for None."""


@dataclass(frozen=True)
class Case:
    """One reference case.

    Attributes:
        name: short name, as in the tables.
        title: what happens, in words.
        kind: which engine trait it asks for.
        scene: the scene that it runs, or the first of several.
        quantities: what is measured.
        measure: runs what the case needs and returns each quantity's value.
        is_smooth: whether the error follows a power of the step, so that an order can be fitted.
    """

    name: str
    title: str
    kind: SceneKind
    scene: RawScene
    quantities: tuple[Quantity, ...]
    measure: Callable[[RunScene], Mapping[str, float]]
    is_smooth: bool = False


LEVEL_G, RISE_S, HOLD_S = 0.5, 0.05, 0.5
BLOCK_SIZE_M = (0.4, 0.3, 0.25)
SLAB_MASSES_KG, SLAB_FRICTIONS = (100.0, 80.0, 60.0, 40.0, 20.0), (0.5, 0.4, 0.3, 0.2, 0.1)
SLAB_SIZE_M = (6.0, 1.0, 0.2)


def reference_suite() -> tuple[Case, ...]:
    """Every case, in the order of the tables."""
    return (
        _block_slip(),
        _inertial_block(),
        _diagonal_block(),
        _stacked_pair(),
        _slabs(),
        _fields(),
        _impact(),
        _creep(),
        _cartons(),
        _tipping(),
    )


def trapezoid(level_g: float, rise_s: float = RISE_S, hold_s: float = HOLD_S) -> RawScene:
    """A sled that accelerates 0 -> A -> 0 and then coasts."""
    a = level_g * GRAVITY
    return {
        "profile": "table",
        "times_s": [0.0, rise_s, rise_s + hold_s, 2.0 * rise_s + hold_s],
        "acceleration_mps2": [0.0, a, a, 0.0],
    }


def boxes_scene(
    name: str,
    sled: RawScene,
    sizes_m: list[tuple[float, float, float]],
    frictions: list[float],
    *,
    masses_kg: list[float] | None = None,
) -> RawScene:
    """Boxes stacked on the sled itself, each interface with a friction of its own, from below."""
    heights = np.cumsum([0.0, *(size[2] for size in sizes_m)])
    faces = ["sled", *(f"face_{i}" for i in range(len(sizes_m)))]
    return {
        "name": name,
        "load": {
            "packages": [
                {
                    "id": f"box_{i}",
                    "size_m": size,
                    "mass_kg": masses_kg[i] if masses_kg else 10.0,
                    "position_m": [0.0, 0.0, float(heights[i]) + size[2] / 2.0],
                    "surface": faces[i + 1],
                }
                for i, size in enumerate(sizes_m)
            ]
        },
        "pallet": None,
        "surfaces": {
            "pairs": [
                {"between": [faces[i], faces[i + 1]], "friction": friction}
                for i, friction in enumerate(frictions)
            ]
        },
        "sled": sled,
    }


def _block_slip() -> Case:
    friction = 0.3
    scene = boxes_scene("block_slip", trapezoid(LEVEL_G), [BLOCK_SIZE_M], [friction])
    slip = 1000.0 * trapezoid_slip_m(LEVEL_G, RISE_S, HOLD_S, friction)

    def measure(run: RunScene) -> dict[str, float]:
        track = run(scene, 1.2)
        return {"slip": -track.moved_mm(1)[-1], "drift": np.abs(track.moved_mm(1, 1)).max()}

    return Case(
        "block slip", "a block sticks, slides and stops on a 0.5 g trapezoid, friction 0.3", "sliding", scene,
        (Quantity("slip", slip, "closed form"), Quantity("drift", 0.0, "zero")), measure, is_smooth=True,
    )  # fmt: skip


def _inertial_block() -> Case:
    scene = boxes_scene("inertial_block", trapezoid(LEVEL_G), [BLOCK_SIZE_M], [0.0])
    travel = 1000.0 * trapezoid_travel_m(LEVEL_G, RISE_S, HOLD_S, 1.2)

    def measure(run: RunScene) -> dict[str, float]:
        track = run(scene, 1.2)
        return {"slip": -track.moved_mm(1)[-1], "drift": np.abs(track.moved_mm(1, 1)).max()}

    return Case(
        "inertial block", "a frictionless block keeps its speed while the sled leaves", "sliding", scene,
        (Quantity("slip", travel, "closed form"), Quantity("drift", 0.0, "zero")), measure,
    )  # fmt: skip


def _diagonal_block() -> Case:
    friction = 0.3
    scene = boxes_scene(
        "diagonal_block", {**trapezoid(LEVEL_G), "direction": 45.0}, [(0.3, 0.3, 0.25)], [friction]
    )
    slip = 1000.0 * trapezoid_slip_m(LEVEL_G, RISE_S, HOLD_S, friction)

    def measure(run: RunScene) -> dict[str, float]:
        track = run(scene, 1.2)
        x, y = track.moved_mm(1), track.moved_mm(1, 1)
        return {"slip": -(x + y)[-1] / np.sqrt(2.0), "drift": np.abs(x - y).max() / np.sqrt(2.0)}

    return Case(
        "square block at 45°", "the block slip along the diagonal of a square footprint", "sliding", scene,
        (Quantity("slip", slip, "closed form"), Quantity("drift", 0.0, "zero")), measure, is_smooth=True,
    )  # fmt: skip


def _stacked_pair() -> Case:
    masses, frictions = [20.0, 10.0], [0.3, 0.2]
    size = (0.8, 0.6, 0.2)
    scene = boxes_scene("stacked_pair", trapezoid(LEVEL_G), [size, size], frictions, masses_kg=masses)

    def measure(run: RunScene) -> dict[str, float]:
        track = run(scene, 0.6)
        return {f"slip {i + 1}": -track.moved_mm(i + 1)[-1] for i in range(2)}

    slips = 1000.0 * slab_slips_m(masses, frictions, LEVEL_G, RISE_S, HOLD_S, 0.6, step_s=1.0e-4)
    return Case(
        "two blocks", "two blocks with different frictions slide on the sled and on each other", "sliding", scene,
        tuple(Quantity(f"slip {i + 1}", float(slip), "own ODE") for i, slip in enumerate(slips)),
        measure, is_smooth=True,
    )  # fmt: skip


def slabs_scene() -> RawScene:
    """Five slabs of falling mass and friction under a 0.45 g trapezoid."""
    return boxes_scene(
        "slabs", trapezoid(0.45, 0.05, 0.4), [SLAB_SIZE_M] * len(SLAB_MASSES_KG), list(SLAB_FRICTIONS),
        masses_kg=list(SLAB_MASSES_KG),
    )  # fmt: skip


@cache
def _slab_slips_mm() -> tuple[float, ...]:
    slips = slab_slips_m(SLAB_MASSES_KG, SLAB_FRICTIONS, 0.45, 0.05, 0.4, 1.2, step_s=1.0e-4)
    return tuple((1000.0 * slips).tolist())


def _slabs() -> Case:
    count = len(SLAB_MASSES_KG)

    def measure(run: RunScene) -> dict[str, float]:
        track = run(slabs_scene(), 1.2)
        slips = {f"slip {i + 1}": -track.moved_mm(i + 1)[-1] for i in range(count)}
        return {**slips, "drift": max(np.abs(track.moved_mm(i + 1, 1)).max() for i in range(count))}

    slips = [Quantity(f"slip {i + 1}", slip, "own ODE") for i, slip in enumerate(_slab_slips_mm())]
    return Case(
        "five slabs", "five slabs of falling mass and friction, 0.45 g trapezoid, at 1.2 s", "sliding",
        slabs_scene(),
        (*slips, Quantity("drift", 0.0, "zero")), measure, is_smooth=True,
    )  # fmt: skip


@cache
def _field_motion() -> tuple[float, float]:
    sled = trapezoid(LEVEL_G)
    motion = field_motion_m(
        mass_kg=10.0, strength_n=10.0 * LEVEL_G * GRAVITY / 4.0, distance_m=0.05, falloff=2.0, friction=0.2,
        knots_s=sled["times_s"], acceleration_mps2=sled["acceleration_mps2"], end_s=1.2,
    )  # fmt: skip
    # The peak as pose frames see it: between two of them it can be 0.01 mm higher.
    seen = np.interp(np.arange(0.0, 1.2, 1.0 / POSES_HZ), motion[:, 0], motion[:, 1])
    return 1000.0 * float(np.abs(seen).max()), 1000.0 * float(motion[-1, 1])


def _fields() -> Case:
    scene = {
        **boxes_scene("fields", trapezoid(LEVEL_G), [BLOCK_SIZE_M], [0.2]),
        "force_fields": {"tension": 1.0, "distance_m": 0.05, "falloff": 2.0},
    }

    def measure(run: RunScene) -> dict[str, float]:
        x = run(scene, 1.2).moved_mm(1)
        return {"peak": np.abs(x).max(), "rest": x[-1]}

    peak, rest = _field_motion()
    return Case(
        "force fields", "a package swings between two force fields until friction holds it", "sliding", scene,
        (Quantity("peak", peak, "own ODE"), Quantity("rest", rest, "own ODE")), measure, is_smooth=True,
    )  # fmt: skip


def _impact() -> Case:
    level, pulse, gap, friction = 0.3, 0.2, 0.1, 0.5
    a = level * GRAVITY
    sled = {"profile": "table", "times_s": [0.0, pulse], "acceleration_mps2": [a, a]}
    scene = boxes_scene("impact", sled, [BLOCK_SIZE_M], [0.0])
    first = scene["load"]["packages"][0]
    x, y, z = first["position_m"]
    scene["load"]["packages"].append(
        {**first, "id": "hit", "surface": "face_1", "position_m": [x - BLOCK_SIZE_M[0] - gap, y, z]}
    )
    scene["surfaces"]["pairs"] += [
        {"between": ["sled", "face_1"], "friction": friction},
        {"between": ["face_0", "face_1"], "friction": 0.0},
    ]

    def measure(run: RunScene) -> dict[str, float]:
        track = run(scene, 1.0)
        return {"first": -track.moved_mm(1)[-1], "second": -track.moved_mm(2)[-1]}

    slips = 1000.0 * np.array(pushed_slides_m(level, pulse, gap, friction))
    return Case(
        "impact", "a sliding block meets a resting one; both go on as one and stop", "impact", scene,
        tuple(
            Quantity(name, float(slip), "closed form")
            for name, slip in zip(("first", "second"), slips, strict=True)
        ),
        measure,
    )  # fmt: skip


def _creep() -> Case:
    scene = boxes_scene("creep", trapezoid(0.45, 0.05, 1.9), [BLOCK_SIZE_M], [0.5])

    def measure(run: RunScene) -> dict[str, float]:
        return {"peak": run(scene, 2.2).peak_mm()}

    return Case(
        "sticking block", "0.45 g for 2 s under a friction of 0.5: it must not creep", "resting", scene,
        (Quantity("peak", 0.0, "zero"),), measure,
    )  # fmt: skip


def cartons_scene(layers: int = 5, *, level_g: float = 0.2, columns: tuple[int, int] = (4, 2)) -> RawScene:
    """Cartons of 10 kg in columns with gaps of 1 mm on an EUR pallet, friction 0.5, one EUMOS run."""
    length, width, height = 0.299, 0.399, 0.25
    places = [
        (0.3 * (i - (columns[0] - 1) / 2.0), 0.4 * (j - (columns[1] - 1) / 2.0), layer)
        for layer in range(layers)
        for i in range(columns[0])
        for j in range(columns[1])
    ]
    pallet = {"kind": "epal1"} if columns == (4, 2) else None
    deck = 0.144 if pallet else 0.0
    return {
        "name": "cartons",
        "load": {
            "packages": [
                {
                    "id": f"carton_{n}",
                    "size_m": [length, width, height],
                    "mass_kg": 10.0,
                    "position_m": [x, y, deck + height * (layer + 0.5)],
                    "layer": layer + 1,
                }
                for n, (x, y, layer) in enumerate(places)
            ]
        },
        "pallet": pallet,
        "surfaces": {
            "pairs": [
                {"between": ["cardboard", other], "friction": 0.5} for other in ("cardboard", "wood", "sled")
            ]
        },
        "sled": {"profile": "eumos", "level_g": level_g},
    }


def pressed_scene() -> RawScene:
    """The cartons at 0.5 g, held by force fields that press them on each other."""
    return {**cartons_scene(level_g=0.5), "name": "pressed_cartons", "force_fields": {}}


def _cartons() -> Case:
    def measure(run: RunScene) -> dict[str, float]:
        return {"peak": run(cartons_scene(), None).peak_mm()}

    return Case(
        "40 cartons", "40 cartons in columns at 0.2 g, under every limit: nothing may move", "resting",
        cartons_scene(),
        (Quantity("peak", 0.0, "zero"),), measure,
    )  # fmt: skip


def _tipping() -> Case:
    depth, height = 0.2, 0.3
    exact = tipping_level_g(depth, height)

    def scene_at(level_g: float) -> RawScene:
        a = level_g * GRAVITY
        sled = {"profile": "table", "times_s": [0.0, 3.0], "acceleration_mps2": [a, a]}
        return boxes_scene("tipping", sled, [(2.0 * depth, 0.3, 2.0 * height)], [1.0])

    def measure(run: RunScene) -> dict[str, float]:
        low, high = 0.98 * exact, 1.02 * exact
        for _ in range(9):  # to 4e-5 of the threshold
            middle = 0.5 * (low + high)
            low, high = (low, middle) if run(scene_at(middle), 3.0).peak_mm() > 10.0 else (middle, high)
        return {"threshold": 0.5 * (low + high)}

    return Case(
        "tipping", "constant level at which a tall box tips, by bisection over nine runs", "threshold",
        scene_at(exact),
        (Quantity("threshold", exact, "closed form", "g"),), measure,
    )  # fmt: skip
