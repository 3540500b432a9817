"""What a viewer shows at first sight: the load large, camera and displacement beside it, the rest below."""

import numpy as np
import rerun.blueprint as rrb

from config.scene import Scene
from msgs_adapters.colours import full_strain
from sim_core.camera.layout import side_of

TIMELINE = "sim_time"
WORLD, SLED, BENCH = "/world", "/world/sled", "/world/bench"
CAMERA = "/camera"
ACCELERATION, DISPLACEMENT = "/plots/acceleration", "/plots/displacement"
RULES, LOG = "/rules", "/log"


def blueprint(scene: Scene) -> rrb.Blueprint:
    """The arrangement for a scene; without a camera, displacement has its place too."""
    load = rrb.Spatial3DView(
        origin=SLED,
        contents=[f"{WORLD}/**"],
        name=_load_name(scene),
        eye_controls=_eye(scene),
        line_grid=False,
    )
    displacement = rrb.TimeSeriesView(
        origin=DISPLACEMENT,
        name="Displacement by height [mm]",
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
        axis_y=rrb.ScalarAxis(zoom_lock=False),
    )
    camera = [rrb.Spatial2DView(origin=f"{CAMERA}/image", name="Camera")] if scene.camera is not None else []
    acceleration = rrb.TimeSeriesView(
        origin=ACCELERATION,
        name="Acceleration along the travel [g]",
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )
    rules = rrb.TextDocumentView(origin=RULES, contents=[RULES], name="Rules")
    states = rrb.StateTimelineView(origin=RULES, name="Rules over time")
    log = rrb.TextLogView(
        origin=LOG,
        name="Log",
        columns=rrb.TextLogColumns(text_log_columns=["loglevel", "body"]),
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                load,
                rrb.Vertical(*camera, displacement, row_shares=[*(1.0 for _ in camera), 1.3]),
                column_shares=[1.1, 1.0],
            ),
            rrb.Horizontal(acceleration, rules, states, log, column_shares=[1.2, 1.0, 1.0, 1.2]),
            row_shares=[1.9, 1.0],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def _load_name(scene: Scene) -> str:
    if scene.film is None:
        return "Load"
    return f"Load; film from blue without strain to red at {100.0 * full_strain(scene.film.around):.0f} %"


def _eye(scene: Scene) -> rrb.EyeControls3D:
    """Looks at the load's middle from above the corner between the camera's side and where it travels to."""
    side = side_of(scene)
    middle = np.array([0.0, 0.0, 0.45 * side.top_m])
    reach = max(side.top_m, side.right_m - side.left_m)
    eye = middle + reach * (1.6 * side.normal + 0.9 * side.right + np.array([0.0, 0.0, 0.75]))
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye, look_target=middle, eye_up=(0, 0, 1))
