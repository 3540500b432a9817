"""What the film's sweeps say, as tables: what was promised, every knob, meshes to choose from, strip, other loads."""

from typing import Any

from sim_core.accuracy.film import DEFAULT_BAR_MM, FilmFindings, FilmSetting, Knob
from sim_core.accuracy.film_strip import BAR


def bar_rows(findings: FilmFindings) -> list[dict[str, Any]]:
    """What the film is held to, and what it comes to."""
    fitted = [knob for knob in findings.knobs if knob.order is not None]
    shown = "; ".join(f"{knob.name}: {order_words(knob)}" for knob in fitted)
    has_order = [knob.name for knob in fitted if knob.has_order]
    default, refined = findings.row(FilmSetting()), findings.row(findings.plan.refined)
    if default is None or refined is None or default.peak_mm is None or refined.peak_mm is None:
        found, holds = "not run", None
    else:
        away = abs(default.peak_mm - refined.peak_mm)
        found = f"{default.peak_mm:.2f} mm ({default.setting.words}; {default.cpu_s:.1f} s)"
        found += (
            f" and {refined.peak_mm:.2f} mm ({refined.setting.words}; {refined.cpu_s:.0f} s): {away:.2f} mm"
        )
        holds = "yes" if away <= DEFAULT_BAR_MM else "no"
    late = {p.stiffness_npm: p.steps + 1 for p in findings.strip if p.error > BAR}
    steps = ", ".join(f"{count} at {stiffness / 1000.0:g} kN/m" for stiffness, count in sorted(late.items()))
    return [
        {
            "bar": "fitted order",
            "found": shown or "too few runs",
            "holds": ", ".join(has_order) + " only" if has_order else "no",
        },
        {
            "bar": f"defaults within {DEFAULT_BAR_MM:g} mm of the refined answer",
            "found": found,
            "holds": holds,
        },
        {"bar": "no result depends on an artificial mass", "found": "there is none", "holds": "yes"},
        {
            "bar": f"strip within {100.0 * BAR:g} % of Hooke",
            "found": f"Newton steps: {steps}",
            "holds": "yes" if all(point.error <= BAR for point in _last_of_strip(findings)) else "no",
        },
    ]


def order_words(knob: Knob) -> str:
    """The fitted order and how far errors lie off it."""
    return "none" if knob.order is None else f"{knob.order[0]:.1f} (errors within × {knob.order[1]:.1f})"


def _last_of_strip(findings: FilmFindings) -> list[Any]:
    return list({point.stiffness_npm: point for point in findings.strip}.values())


def knob_rows(findings: FilmFindings) -> list[dict[str, Any]]:
    """Every run of every knob, coarse to fine; the finest is what the others are compared with."""
    found = []
    for knob in findings.knobs:
        runs = [*knob.points, *([] if "," in knob.name else [(None, None, knob.reference)])]
        for _, error, row in runs:
            found.append({
                "knob": knob.name,
                "step": f"1/{row.rate_hz}",
                "spacing [m]": f"{row.spacing_m:g}",
                "tolerance": f"{row.tolerance:g}",
                "peak [mm]": f"{row.peak_mm:.2f}",
                "error [mm]": "reference" if error is None else f"{error:.2f}",
                "peak strain": f"{row.peak_strain:.2f}",
                "peak pull [kN/m]": f"{row.peak_force_npm / 1000.0:.2f}",
                "nodes": row.nodes,
                "largest force left": f"{row.residual:.1g}",
                "processor / wall [s]": f"{row.cpu_s:.1f} / {row.wall_s:.1f} ({row.repeats})",
            })  # fmt: skip
    return found


def spacing_rows(findings: FilmFindings) -> list[dict[str, Any]]:
    """The meshes that a tolerance chooses from."""
    return [
        {"spacing [m]": f"{row.spacing_m:g}", "error [mm]": f"{row.error_mm:.2g}"}
        for row in findings.spacings
    ]


def load_rows(findings: FilmFindings) -> list[dict[str, Any]]:
    """Peak displacement of each further load over step and mesh [mm], beside the cartons'."""
    found = []
    for load in ("cartons", *findings.plan.loads):
        for name, settings in findings.plan.by_load(load).items():
            entry: dict[str, Any] = {"load": load, "over": name}
            for number, setting in enumerate(settings, start=1):
                row = findings.row(setting, load)
                value = f"1/{setting.rate_hz}" if name == "rigid step" else f"{setting.spacing_m:g} m"
                peak = "" if row is None or row.peak_mm is None else f": {row.peak_mm:.2f}"
                entry[f"peak {number} [mm]"] = value + peak
            found.append(entry)
    return found
