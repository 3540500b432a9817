"""The report's figures as inline SVG: how they are drawn and coloured, and load and sled over time.

matplotlib is imported inside the functions that draw, and its settings are put back after each figure.
Colours are placeholders that become CSS variables, so that the page's light, dark and print styles hold
for the figures too. No text that a user gave stands in a figure: it belongs into the page around it.
"""

import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from config.scene import RecordedSled, Scene, direction_vector
from sim_core.frames import GRAVITY, Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Report = dict[str, Any]

INK, FAINT, GRID, BAD, STOP, PALLET, SLED, PAPER = (f"#0101{k:02x}" for k in range(1, 9))
BANDS = tuple(f"#0102{k:02x}" for k in range(1, 7))
_CSS_NAMES = dict(
    zip(
        (INK, FAINT, GRID, BAD, STOP, PALLET, SLED, PAPER, *BANDS),
        ("ink", "faint", "grid", "bad", "stop", "pallet", "sled", "paper", *(f"band{k}" for k in range(6))),
        strict=True,
    )
)
_DASHES: tuple[Any, ...] = (
    (0, (1, 1)), (0, (4, 1.5, 1, 1.5)), (0, (5, 2)), (0, (8, 2, 2, 2)), (0, (10, 1.5)), "solid",
)  # fmt: skip
HALO = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.85, "pad": 1.0}
WIDTH_IN = 9.0


def travel_direction(report: Report, scene: Scene) -> tuple[float, float]:
    """Unit vector (x, y) of the travel; that of the strongest acceleration where the samples are recorded."""
    if not isinstance(scene.sled, RecordedSled):
        return direction_vector(scene.sled.direction)
    accelerations = np.array(report["sled"]["acceleration_mps2"]).reshape(-1, 3)[:, :2]
    strengths = np.hypot(*accelerations.T)
    if not len(strengths) or strengths.max() < 1.0e-6:
        return 1.0, 0.0
    x, y = accelerations[int(strengths.argmax())] / strengths.max()
    return float(x), float(y)


def time_figure(report: Report, scene: Scene, label: str) -> str:
    """Displacement by height band, the sled's acceleration and its velocity, over one time axis.

    Args:
        report: a report, with or without series.
        scene: its scene.
        label: text alternative, already safe to stand in HTML.
    """
    from matplotlib.figure import Figure

    series = report.get("series") or {"times_s": [], "displacement_mm": [], "bands": [], "band_edges_m": []}
    end_s = max([report["sled"]["stop_s"], *series["times_s"][-1:]]) or 1.0
    with drawing_settings():
        figure = Figure(figsize=(WIDTH_IN, 6.2))
        load, acceleration, velocity = figure.subplots(
            3, 1, sharex=True, height_ratios=[3.4, 1.0, 1.0],
            gridspec_kw={"left": 0.075, "right": 0.825, "top": 0.985, "bottom": 0.075, "hspace": 0.1},
        )  # fmt: skip
        _draw_series(load, report, series, end_s)
        _draw_sled(acceleration, velocity, report, scene, end_s)
        for axes in (load, acceleration, velocity):
            axes.axvline(report["sled"]["stop_s"], color=STOP, linewidth=1.0, linestyle=(0, (2, 2)))
            axes.grid(True, color=GRID, linewidth=0.5)
        velocity.set_xlim(0.0, end_s)
        velocity.set_xlabel("time since the first frame [s]")
        return svg_text(figure, label, "time")


def drawing_settings() -> Any:
    """Matplotlib's shipped settings, whatever the user's are, while a figure is drawn and written."""
    from matplotlib import style

    return style.context(
        [
            "default",
            {
                "svg.fonttype": "none", "font.size": 8.0, "axes.titlesize": 8.5, "axes.labelsize": 8.0,
                "axes.titlelocation": "left", "text.parse_math": False, "text.color": INK,
                "axes.labelcolor": INK,
                "axes.edgecolor": FAINT, "xtick.color": FAINT, "ytick.color": FAINT, "xtick.labelcolor": INK,
                "ytick.labelcolor": INK, "legend.facecolor": PAPER, "legend.edgecolor": GRID,
                "legend.framealpha": 0.85, "axes.facecolor": "none", "figure.facecolor": "none",
                "savefig.facecolor": "none", "axes.spines.top": False, "axes.spines.right": False,
            },
        ]
    )  # fmt: skip


def svg_text(figure: "Figure", label: str, salt: str) -> str:
    """The figure as an ``<svg>`` element: no date, ids of its own, CSS variables for colours."""
    import matplotlib

    matplotlib.rcParams["svg.hashsalt"] = salt
    buffer = io.StringIO()
    figure.savefig(
        buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
    )
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(
        r"<metadata>.*?</metadata>|<!--.*?-->|<defs>\s*<style.*?</style>\s*</defs>", "", text, flags=re.DOTALL
    )
    text = re.sub(r'(?<=<g) id="[^"]*"|(?<=px;) font-family: [^;]*;', "", text)
    text = re.sub(
        r'\b(?:d|x|y|transform)="[^"]*"', lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), text
    )
    text = re.sub(r"#010[12]0[0-9a-f]", lambda found: f"var(--{_CSS_NAMES[found[0]]})", text)
    text = re.sub(r"\s*\n\s*", "\n", text)
    view = re.search(r'viewBox="[^"]*"', text)
    assert view is not None
    return f'<svg role="img" aria-label="{label}" xmlns:xlink="http://www.w3.org/1999/xlink" {view[0]}>' + (
        text[text.index(">") + 1 :].strip()
    )


def _draw_series(axes: "Axes", report: Report, series: dict[str, Any], end_s: float) -> None:
    edges, highest = series["band_edges_m"], 1.0
    for band, row in reversed(list(zip(series["bands"], series["displacement_mm"], strict=True))):
        name = f"{edges[band]:.2f} to {edges[band + 1]:.2f} m"
        axes.plot(
            series["times_s"],
            row,
            color=BANDS[band % 6],
            linestyle=_DASHES[band % 6],
            linewidth=1.4,
            label=name,
        )
        highest = max(highest, *row)
    limits = {rule["rule"]: rule["limit_mm"] for rule in report["rules"] if rule["limit_mm"] is not None}
    highest = max([highest, *(limits[rule] for rule in ("elastic", "permanent") if rule in limits)])
    for rule, words, style in (("elastic", "elastic limit, for the peak", "solid"),
                               ("permanent", "permanent limit, for the end", (0, (6, 3)))):  # fmt: skip
        if rule not in limits:
            continue
        axes.axhline(limits[rule], color=BAD, linewidth=1.1, linestyle=style)
        # Above its line, or below the lower one; where that has no room, both above the upper one.
        place, offset, side = limits[rule], 3, "bottom"
        if "elastic" in limits and limits.get("permanent", highest) < 0.08 * highest:
            place, offset = max(limits["elastic"], limits["permanent"]), 14 if rule == "elastic" else 3
        elif rule == "permanent":
            offset, side = -4, "top"
        axes.annotate(f"{words}: {limits[rule]:.1f} mm", (end_s, place), (-3, offset),
                      textcoords="offset points",
                      ha="right", va=side, color=BAD, bbox=HALO)  # fmt: skip
    velocities = report["sled"]["velocity_mps"]
    comes_to_rest = not velocities or float(np.linalg.norm(velocities[-1])) < 0.01
    stop_s, last_s = report["sled"]["stop_s"], (series["times_s"] or [end_s])[-1]
    _mark_time(
        axes, stop_s, "sled stands from here" if comes_to_rest else "sled's profile ends", highest, end_s
    )
    if last_s < stop_s - 1.0e-6:
        axes.axvline(last_s, color=BAD, linewidth=1.0)
        _mark_time(axes, last_s, "test ended here", highest, end_s)
    axes.set_ylim(0.0, 1.12 * highest)
    axes.set_ylabel("largest displacement [mm]")
    if series["bands"]:
        axes.legend(
            title="height of the corners",
            loc="upper left",
            bbox_to_anchor=(1.01, 1.0),
            handlelength=4.0,
            frameon=False,
        )
    else:
        axes.text(0.5, 0.5, "no package, no displacement", transform=axes.transAxes, ha="center", color=FAINT)


def _mark_time(axes: "Axes", time_s: float, words: str, highest: float, end_s: float) -> None:
    is_early = time_s < 0.55 * end_s
    axes.annotate(
        f"{words}: {time_s:.2f} s",
        (time_s, 1.12 * highest),
        (4 if is_early else -4, -2),
        textcoords="offset points",
        color=STOP,
        ha="left" if is_early else "right",
        va="top",
        bbox=HALO,
    )


def _draw_sled(acceleration: "Axes", velocity: "Axes", report: Report, scene: Scene, end_s: float) -> None:
    direction = np.array([*travel_direction(report, scene), 0.0])
    times = np.array(report["sled"]["times_s"])
    along_g = np.array(report["sled"]["acceleration_mps2"]).reshape(-1, 3) @ direction / GRAVITY
    speeds = np.array(report["sled"]["velocity_mps"]).reshape(-1, 3) @ direction
    acceleration.plot([0.0, *times, end_s], [0.0, *along_g, 0.0], color=BANDS[1], linewidth=1.4)
    acceleration.axhline(0.0, color=FAINT, linewidth=0.5)
    fine_times, fine_speeds = _speed_curve(times, along_g * GRAVITY, speeds)
    velocity.plot([0.0, *fine_times, end_s], [0.0, *fine_speeds, *speeds[-1:]], color=BANDS[1], linewidth=1.4)
    velocity.axhline(0.0, color=FAINT, linewidth=0.5)
    acceleration.set_ylabel("sled's acc. [g]")
    velocity.set_ylabel("velocity [m/s]")


def _speed_curve(times: Array, accelerations: Array, speeds: Array) -> tuple[Array, Array]:
    """Velocity between knots of linear acceleration, v0 + a0·τ + j·τ²/2; dense profiles stay as they are."""
    if len(times) > 200 or len(times) < 2:
        return times, speeds
    shares = np.linspace(0.0, 1.0, 9)
    lasting = np.diff(times)[:, None]
    first, last = accelerations[:-1, None], accelerations[1:, None]
    curve = speeds[:-1, None] + lasting * (first * shares + 0.5 * (last - first) * shares**2)
    return (times[:-1, None] + lasting * shares).ravel(), curve.ravel()
