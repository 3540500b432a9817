"""The accuracy page: one self-contained HTML file with the figures, the fronts and every row."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim_core.accuracy.bare_loops import LoopCost
from sim_core.accuracy.cases import Case
from sim_core.accuracy.coverage import Coverage
from sim_core.accuracy.figures import growth_figure, order_figure, standalone_svg, work_precision_figure
from sim_core.accuracy.fronts import Choice, GrowthPoint, Order, as_table
from sim_core.accuracy.sweep import Row
from sim_core.report_style import STYLE
from sim_core.work_precision import AUTO_TOLERANCE_MM

if TYPE_CHECKING:
    from sim_core.accuracy.film import FilmFindings


def write_page(
    out: Path,
    rows: Sequence[Row],
    cases: Sequence[Case],
    orders: Sequence[Order],
    choices: Sequence[Choice],
    points: Sequence[GrowthPoint],
    covered: Sequence[Coverage],
    loops: Sequence[LoopCost],
    film: "FilmFindings | None" = None,
) -> None:
    """Writes ``accuracy.html`` and each figure as an SVG file of its own.

    Args:
        out: an existing folder.
        rows: the sweep.
        cases: its cases.
        orders: fitted orders.
        choices: cheapest settings.
        points: growth with the size of the load; may be empty.
        covered: how often the error estimate holds; may be empty.
        loops: raw engine loops beside our tests; may be empty.
        film: the film's own sweeps, where they were run.
    """
    names = list(dict.fromkeys(case.name for case in cases))
    smooth = [name for name in names if any(order.case == name for order in orders)]
    figures = {"work_precision": work_precision_figure(rows, names)}
    if smooth:
        figures["order"] = order_figure(rows, smooth, orders)
    if points:
        figures["growth"] = growth_figure(points)
    figures |= film_figures(film) if film is not None else {}
    for name, svg in figures.items():
        (out / f"{name}.svg").write_text(standalone_svg(svg), encoding="utf-8")
    captions = {
        "work_precision": "Error against wall time. Dashed: what is allowed. Labels: the step.",
        "order": "Error against step, with the order fitted to all errors above 1 µm.",
        "growth": "Real-time factor against packages, and time a step against contacts.",
        "film": "The film: error against time. A panel a knob; the default is ringed, dashed is 1 mm.",
        "film_strip": "A pulled strip. Error of its elongation over Newton steps; dashed is 0.5 %.",
    }
    sections = [
        _section(
            captions[name].split(".")[0],
            f"<figure>{svg}<figcaption>{escape(captions[name])}</figcaption></figure>",
        )
        for name, svg in figures.items()
    ]
    failed = [row for row in rows if row.failed]
    sections += [
        _section("Cheapest setting inside a tolerance", table(as_table(choices))),
        *([_section("Does the error estimate hold?", table(coverage_rows(covered)))] if covered else []),
        *([_section("What our layers cost", table(loop_rows(loops)))] if loops else []),
        *([_film_section(film)] if film is not None else []),
        _section("Cases", table([{"case": case.name, "what happens": case.title} for case in cases])),
        _section(
            "Omissions", table(omission_rows(failed)) if failed else "<p>Every setting ran to its end.</p>"
        ),
        _section("Every row", table([row_entry(row) for row in rows])),
    ]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Accuracy</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}</style></head>'
        "<body><main><header><p class='kicker'>pallet-twin</p><h1>Error against run time</h1>"
        "<p>Each row is one case at one setting: its error against a reference, and what it cost.</p></header>"
        f"{''.join(sections)}</main></body></html>\n"
    )
    scratch = out / "accuracy.html.part"
    scratch.write_text(page, encoding="utf-8")
    scratch.replace(out / "accuracy.html")


def film_figures(film: "FilmFindings") -> dict[str, str]:
    """The film's figures by name."""
    from sim_core.accuracy.film_figures import knobs_figure, strip_figure

    return {"film": knobs_figure(film, AUTO_TOLERANCE_MM), "film_strip": strip_figure(film.strip)}


def _film_section(film: "FilmFindings") -> str:
    from sim_core.accuracy.film_tables import bar_rows, knob_rows, load_rows, spacing_rows

    return _section(
        "The film in figures",
        table(bar_rows(film))
        + "<h3>Meshes that a tolerance chooses from</h3>" + table(spacing_rows(film))
        + "<h3>Every knob</h3>" + table(knob_rows(film))
        + "<h3>Loads on which chance decides</h3>" + table(load_rows(film)),
    )  # fmt: skip


def row_entry(row: Row) -> dict[str, Any]:
    """A row as the page shows it."""
    worst = max(row.quantities, key=lambda q: q.error / q.bar, default=None)
    return {
        "case": row.case,
        "setting": row.setting.words,
        "worst quantity": "failed" if worst is None else f"{worst.name} ({worst.reference_kind})",
        "error": None if worst is None else f"{worst.error:.3g} {'' if worst.unit == 'g' else worst.unit}",
        "of allowed": None if row.bars is None else f"{row.bars:.2f}",
        "wall min / median / max [s]": None
        if row.wall_min_s is None
        else f"{row.wall_min_s:.3f} / {row.wall_median_s:.3f} / {row.wall_max_s:.3f} ({row.repeats})",
        "real-time factor": None if row.real_time_factor is None else f"{row.real_time_factor:.1f}",
        "contacts": row.contacts,
        "overlap [mm]": f"{row.penetration_mm:.3f}",
        "residual": f"{row.residual:.1e}",
    }


def coverage_rows(covered: Sequence[Coverage]) -> list[dict[str, Any]]:
    """Coverage as the page shows it."""
    return [
        {
            "engine": entry.engine,
            "quantities": entry.quantities,
            "true error inside the estimate": f"{100.0 * entry.inside:.1f} %",
            "median estimate / error (errors over 0.01 mm)": f"{entry.median_ratio:.1f} ({entry.seen})",
            "outside": "; ".join(entry.misses[:5]) or "none",
        }
        for entry in covered
    ]


def loop_rows(loops: Sequence[LoopCost]) -> list[dict[str, Any]]:
    """Raw loops and our tests as the page shows them."""
    return [
        {
            "loop": loop.name,
            "peak, all error [mm]": "" if loop.peak_mm != loop.peak_mm else f"{loop.peak_mm:.2f}",
            "wall min / median [s]": f"{loop.wall_min_s:.3f} / {loop.wall_median_s:.3f}",
            "wall s per simulated s": f"{loop.wall_min_s / loop.simulated_s:.4f}",
        }
        for loop in loops
    ]


def omission_rows(failed: Sequence[Row]) -> list[dict[str, Any]]:
    """Failed rows with their reasons."""
    return [{"case": row.case, "setting": row.setting.words, "why": row.reason} for row in failed]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows of one shape as an HTML table."""
    if not rows:
        return "<p>None.</p>"
    head = "".join(f"<th>{escape(str(name))}</th>" for name in rows[0])
    body = "".join(
        "<tr>"
        + "".join(f"<td>{'' if value is None else escape(str(value))}</td>" for value in row.values())
        + "</tr>"
        for row in rows
    )
    return f"<div class='scroll'><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{content}</section>"
