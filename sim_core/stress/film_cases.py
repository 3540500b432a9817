"""Wrapped loads of the stability table as raw scene parts, and what their films must do, solved without a mesh."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from config.scene import Scene
from config.wrap import FilmLaw, FilmProperties, film_span
from sim_core.frames import GRAVITY, Array
from sim_core.stress.loads import CARTON, Raw, Size, block_of, box, scene_of, trapezoid

STRETCH: Raw = {"material": "stretch_film_20", "turns": 3}
KRAFT: Raw = {"material": "kraft_80", "turns": 1}
DECK_M = 0.1
"""Height of the pallets: what the film overlaps by default."""
PATIENCE_S = 30.0
"""The longest of these scenes takes a third of it, where it comes to an end at all."""
ENERGY_SHARE = 0.05
"""The energy monitor's limit: a run that was not ended keeps it."""
ON_PALLET, ON_EACH_OTHER = 0.3, 0.5
"""Frictions: not the same, for where every interface is at its limit at once the physics itself has many answers."""
RISE_S = 0.05
BAND_HEIGHT_M, BAND_LENGTH_M, BAND_WIDTH_M = 0.25, 0.8, 0.3
TOP_MARGIN_M = 2.0e-3
"""The film ends this far below the load's top."""


def bound_scene(
    engine: str,
    boxes: Sequence[Raw],
    wrap: Raw | None,
    *,
    level_g: float = 0.4,
    hold_s: float = 0.2,
    deck_m: tuple[float, float] = (0.802, 0.602),
    friction: float = ON_PALLET,
    sled: Raw | None = None,
    **parts: Any,
) -> Scene:
    """Boxes, given from the deck up, on a pallet that is blocked on the sled.

    Args:
        engine: rigid engine.
        boxes: packages as raw parts, by height above the deck.
        wrap: the wrap as a raw part, or None.
        level_g: of the trapezoid [g].
        hold_s: how long [s].
        deck_m: the pallet's length and width [m].
        friction: of the boxes on the deck.
        sled: a profile in place of the trapezoid.
        parts: further parts of the scene, as they are.
    """
    lifted = [{**b, "position_m": [*b["position_m"][:2], b["position_m"][2] + DECK_M]} for b in boxes]
    return scene_of(
        "film", lifted, sled or trapezoid(level_g, hold_s=hold_s), engine=engine,
        pairs={("cardboard", "wood"): friction, ("cardboard", "cardboard"): ON_EACH_OTHER},
        pallet={"size_m": [*deck_m, DECK_M], "mass_kg": 20.0, "fixed": True}, **_wrapped(wrap), **parts,
    )  # fmt: skip


def loose_scene(
    engine: str, boxes: Sequence[Raw], wrap: Raw | None, *, level_g: float = 0.4, **parts: Any
) -> Scene:
    """Boxes on the sled itself, that hold on each other far better than on the sled: the film ties them to nothing."""
    return scene_of(
        "film", boxes, trapezoid(level_g, hold_s=0.2), engine=engine,
        pairs={("cardboard", "sled"): ON_PALLET, ("cardboard", "cardboard"): 1.0}, **_wrapped(wrap), **parts,
    )  # fmt: skip


def block_scene(engine: str, wrap: Raw | None, *, mass_kg: float = 10.0, **more: Any) -> Scene:
    """One carton on a pallet of its own size."""
    return bound_scene(engine, [box("a", CARTON, mass_kg)], wrap, deck_m=CARTON[:2], **more)


def stack_scene(engine: str, wrap: Raw | None, *, mass_kg: float = 10.0, **more: Any) -> Scene:
    """Two columns of two cartons on a pallet, without a gap that a film could close."""
    boxes = block_of((2, 1, 2), CARTON, mass_kg, gap_m=0.0)
    return bound_scene(engine, boxes, wrap, deck_m=(0.8, 0.3), **more)


def grid(
    counts: tuple[int, int, int] = (2, 2, 2),
    *,
    size_m: Size = (0.4, 0.3, 0.2),
    mass_kg: float = 10.0,
    gap_m: float = 1.0e-3,
) -> list[Raw]:
    """A block of like boxes."""
    return block_of(counts, size_m, mass_kg, gap_m=gap_m)


def _wrapped(wrap: Raw | None) -> Raw:
    return {} if wrap is None else {"wrap": wrap}


def _raised(boxes: Sequence[Raw], by_m: float, prefix: str) -> list[Raw]:
    return [
        {**b, "id": prefix + b["id"], "position_m": [*b["position_m"][:2], b["position_m"][2] + by_m]}
        for b in boxes
    ]


_SMALL: Size = (0.26, 0.2, 0.2)
_CUBE: Size = (0.3, 0.3, 0.2)
SHAPES: Mapping[str, Sequence[Raw]] = {
    "one_box": [box("a", CARTON, 10.0)],
    "tall": [box("a", (0.4, 0.3, 0.9), 50.0)],
    "taper": [
        box("a", (0.8, 0.6, 0.2), 30.0), box("b", (0.6, 0.45, 0.2), 20.0, base_m=0.2),
        box("c", (0.4, 0.3, 0.2), 10.0, base_m=0.4), box("d", (0.2, 0.15, 0.2), 5.0, base_m=0.6),
    ],
    "mushroom": [
        box("a", (0.4, 0.3, 0.2), 30.0), box("b", (0.6, 0.45, 0.2), 20.0, base_m=0.2),
        box("c", (0.8, 0.6, 0.2), 10.0, base_m=0.4),
    ],
    "hollow": [b for b in grid((3, 3, 2), size_m=_SMALL) if "-2-2" not in b["id"]],
    "turned_45": [
        box("a", _CUBE, 10.0, yaw_deg=45.0), box("b", _CUBE, 10.0, base_m=0.2),
        box("c", _CUBE, 10.0, base_m=0.4, yaw_deg=45.0),
    ],
    "low_boxes": [
        *grid((2, 2, 1)), *_raised(grid((2, 2, 1), size_m=(0.4, 0.3, 0.02), mass_kg=1.0), 0.2, "low_"),
        *_raised(grid((2, 2, 1)), 0.22, "top_"),
    ],
    "plates": grid((2, 2, 3), size_m=(0.4, 0.3, 0.02), mass_kg=2.0),
    "touching": grid(gap_m=0.0),
    "gapped": grid(),
    "gapped_10mm": grid(gap_m=0.01),
}  # fmt: skip
"""Loads by name, each its own mirror image in y."""


def band_scene(
    engine: str, wrap: Raw, *, mass_kg: float, level_g: float = 0.5, hold_s: float = 0.1, **parts: Any
) -> Scene:
    """Two boxes side by side in one film: the first sticks to the sled, the second slides off it without friction."""
    size = (BAND_LENGTH_M / 2.0, BAND_WIDTH_M, BAND_HEIGHT_M)
    boxes = [
        box("sticks", size, 2000.0, x=BAND_LENGTH_M / 4.0, surface="grip"),
        box("slides", size, mass_kg, x=-BAND_LENGTH_M / 4.0, surface="slick"),
    ]
    return scene_of(
        "band", boxes, trapezoid(level_g, rise_s=RISE_S, hold_s=hold_s), engine=engine,
        pairs={("grip", "sled"): 1.0, ("slick", "sled"): 0.0, ("grip", "slick"): 0.0},
        wrap={"friction": 0.0, **wrap}, **parts,
    )  # fmt: skip


def band_opening_m(
    film: FilmProperties,
    *,
    layers: float,
    mass_kg: float,
    level_g: float,
    hold_s: float,
    end_s: float,
    tears: bool = False,
    long_sides_only: bool = False,
    stiffening: float = 1.0,
    step_s: float = 2.0e-5,
) -> Array:
    """How far the two boxes of :func:`band_scene` come apart, solved as one spring: times and ways, shape [n, 2].

    Film without friction is one hoop: m·x'' = m·a − 2·T·h with T the film law's force at the hoop's strain
    (1 + ε0)·(1 + 2x/perimeter) − 1, which flows past its yield force and is gone past its break strain. It ends
    where the boxes meet again.

    Args:
        film: one layer.
        layers: how many.
        mass_kg: of the box that slides [kg].
        level_g: of the trapezoid [g].
        hold_s: how long [s].
        end_s: where to stop [s].
        tears: whether it breaks.
        long_sides_only: film that sticks to the edges: the sides across the way keep their strain.
        stiffening: of the stiffness, for film that may not narrow.
        step_s: semi-implicit step [s].
    """
    law, height = film.around, BAND_HEIGHT_M - TOP_MARGIN_M
    hoop = 2.0 * BAND_LENGTH_M + (0.0 if long_sides_only else 2.0 * BAND_WIDTH_M)
    modulus = law.stiffness_npm * stiffening
    start = film.tension_npm / law.stiffness_npm
    pulled = film.tension_npm - modulus * start
    set_strain, yield_force, is_whole = 0.0, law.yield_force_npm, True
    times = np.arange(round(end_s / step_s)) * step_s
    knots = (0.0, RISE_S, RISE_S + hold_s, 2.0 * RISE_S + hold_s)
    pushes = np.interp(times, knots, (0.0, 1.0, 1.0, 0.0)) * level_g * GRAVITY
    ways = np.zeros_like(times)
    way = speed = 0.0
    for i, push in enumerate(pushes.tolist()):
        ways[i] = way
        strain = (1.0 + start) * (1.0 + 2.0 * way / hoop) - 1.0
        force = pulled + modulus * (strain - set_strain)
        if force > yield_force:
            # Of the strain past the yield a share h stays elastic: h·E is the slope after it.
            flow = (force - yield_force) / modulus * (1.0 - law.hardening)
            yield_force = force - modulus * flow
            set_strain, force = set_strain + flow, yield_force
        is_whole = is_whole and not (tears and strain > law.break_strain)
        pull = 2.0 * height * layers * max(force, 0.0) if is_whole else 0.0
        speed += (push - pull / mass_kg) * step_s
        way += speed * step_s
        if way < 0.0:
            if ways[: i + 1].max() > 1.0e-4:
                return np.column_stack([times, ways])[: i + 1]
            way = speed = 0.0
    return np.column_stack([times, ways])


def toughness_j(scene: Scene) -> float:
    """Energy that tears all of a scene's film both ways [J]: layers · area · ∫F dε; more it can never lose.

    The area is that around the load's bounding box, which is more than the film's.
    """
    film, wrap = scene.film, scene.wrap
    if film is None or wrap is None or not isinstance(wrap.turns, float | int):
        raise ValueError("the scene has no film of one number of layers")
    deck = scene.pallet_box.size_m if scene.pallet_box is not None else (0.0, 0.0, 0.0)
    reach = np.array([np.hypot(*p.size_m[:2]) / 2.0 for p in scene.packages])
    places = np.array([p.position_m for p in scene.packages])
    spans = [
        max(edge, 2.0 * float((np.abs(places[:, axis]) + reach).max())) for axis, edge in enumerate(deck[:2])
    ]
    top = max(p.position_m[2] + p.size_m[2] / 2.0 for p in scene.packages)
    lower, upper = film_span(wrap, deck_m=deck[2], top_m=top)
    area = 2.0 * sum(spans) * (upper - lower)
    return float(wrap.turns * area * (_to_break(film.around) + _to_break(film.up)))


def _to_break(law: FilmLaw) -> float:
    """∫F dε up to the break [J/m²]."""
    bend = min(law.yield_force_npm / law.stiffness_npm, law.break_strain)
    elastic = 0.5 * law.stiffness_npm * bend**2
    drawn = 0.5 * (law.stiffness_npm * bend + law.break_force_npm) * (law.break_strain - bend)
    return elastic + drawn
