"""A user's own scene as a case: its quantities of interest against a finer run of the same engine."""

from collections.abc import Collection, Mapping

import numpy as np

from config.scene import Scene
from sim_core.accuracy.cases import Case, Quantity, RunScene, Track
from sim_core.accuracy.sweep import Cost, Setting, run_track
from sim_core.integrity import supports
from sim_core.work_precision import AUTO_TOLERANCE_MM, scene_kind

SLIPS_FROM_MM = 0.5


def scene_case(scene: Scene, finest: Setting, *, only: Collection[str] | None = None) -> Case:
    """The scene as a case, its reference from one run at the finest setting.

    Quantities: largest elastic and permanent displacement, slip at each interface, the time of the first slip
    of more than 0.5 mm (where one slips), and the smallest margin to a limit. The allowed error in mm is
    the scene's own tolerance (1 mm where it has none), for the time a pose interval.

    Args:
        scene: a resolved scene.
        finest: the setting that the reference is taken from.
        only: the quantities to measure, or None for all.

    Raises:
        PalletTwinError: the finest run was refused, or a monitor ended it.
    """
    raw = scene.model_dump(mode="json")
    reference = {
        name: value
        for name, value in measured_on(run_track(finest.applied(raw), None, Cost())).items()
        if only is None or name in only
    }
    tolerance_mm = scene.solver.tolerance_mm or AUTO_TOLERANCE_MM

    def measure(run: RunScene) -> Mapping[str, float]:
        values = measured_on(run(raw, None))
        # A run that never slips is off by the whole time that the reference slips for.
        return {name: values.get(name, 0.0) for name in reference}

    return Case(
        scene.name, f"{scene.name}, against 1/{finest.rate_hz} × {finest.iterations} of the same engine",
        scene_kind(scene), raw,
        tuple(
            Quantity(name, value, "self-refined", "s", 1.0 / scene.sampling.poses_hz)
            if name == "first slip" else Quantity(name, value, "self-refined", "mm", tolerance_mm)
            for name, value in reference.items()
        ),
        measure, is_smooth=True,
    )  # fmt: skip


def measured_on(track: Track) -> dict[str, float]:
    """The quantities of interest of one run, by name [mm, or s for ``first slip``]."""
    judge = track.judge()
    rules = judge.rules()
    worst = {rule.rule: rule.worst_mm for rule in rules if rule.worst_mm is not None}
    margins = [rule.margin_mm for rule in rules if rule.margin_mm is not None]
    slips = _slips_mm(track)
    values = {
        "elastic": worst["elastic"],
        "permanent": worst["permanent"],
        "margin": min(margins),
        **{name: float(slip.max()) for name, slip in slips.items()},
    }
    largest = np.max(list(slips.values()), axis=0) if slips else np.zeros(len(track.frames))
    if (largest > SLIPS_FROM_MM).any():
        first = track.frames[int(np.argmax(largest > SLIPS_FROM_MM))]
        values["first slip"] = (first.stamp_ns - track.frames[0].stamp_ns) / 1.0e9
    return values


def _slips_mm(track: Track) -> dict[str, np.ndarray]:
    """Largest horizontal slip of a package on what carries it, by interface and frame [mm]."""
    scene = track.scene
    places = np.array([frame.positions[:, :2] for frame in track.frames])
    moved = 1000.0 * (places - places[0])
    slips: dict[str, np.ndarray] = {}
    for support in supports(scene):
        below = max(support.below, -1)
        layers = [scene.packages[i].layer or 0 if i >= 0 else 0 for i in (below, support.package)]
        name = f"slip {layers[0]}-{layers[1]}"
        # On the sled itself row 0 is a point that never moves.
        slip = np.linalg.norm(moved[:, support.package + 1] - moved[:, below + 1], axis=1)
        slips[name] = np.maximum(slips.get(name, 0.0), slip)
    return dict(sorted(slips.items()))
