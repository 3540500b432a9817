"""The page of the camera: what its measurement is worth, held against the poses, and what its pictures cost."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from sim_core.accuracy.page import table
from sim_core.camera.cost import CameraCost
from sim_core.report_style import STYLE
from sim_core.vision.sight_figures import (
    LOOK_WORDS,
    cost_figure,
    deviation_figure,
    level_figure,
    rms_figure,
    taking_figure,
)
from sim_core.vision.sweep import BARS_MM, FORMAT, SightRow, SightSummary, summaries, versions_used

_NO_ROWS = "<p>This folder holds no row of these versions: <code>pallet-twin sight</code> measures them.</p>"
_NO_COST = "<p>Left out of this run: <code>pallet-twin sight --only-cost</code> measures it.</p>"


def write_sight_page(out: Path, rows: Sequence[SightRow], cost: CameraCost | None) -> Path:
    """Writes ``sight.html``: the same rows, costs and versions give the same bytes.

    Args:
        out: an existing folder.
        rows: the sweep's, as many as there are; may be none.
        cost: of pictures; None where it was not measured.

    Returns:
        The page's path.
    """
    path = out / "sight.html"
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(sight_page(rows, cost), encoding="utf-8")
    scratch.replace(path)
    return path


def sight_page(rows: Sequence[SightRow], cost: CameraCost | None) -> str:
    """The page as HTML that needs no other file; see ``write_sight_page``."""
    used = versions_used()
    by = f"From <code>pallet-twin sight</code>, version {escape(used['pallet-twin'])}"
    measured = f"{by}: <code>sight.json</code>, {len(rows)} simulated tests."
    timed = f"{by}: <code>sight_cost.json</code>, measured by the run that wrote this page."
    footer = (
        f"<footer><h2>Made with</h2><p>{escape(', '.join(f'{name} {number}' for name, number in used.items()))};"
        f" rows of format {FORMAT}. A row of other versions is measured anew.</p></footer>"
    )
    sections = (*_worth(rows, summaries(rows), measured), *_cost(rows, cost, measured, timed), footer)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Sight</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{STYLE}</style></head>'
        f"<body><main>{_header(rows, cost)}{''.join(sections)}</main></body></html>\n"
    )


def cost_table(cost: CameraCost) -> list[dict[str, Any]]:
    """The cost's rows as page and command line show them."""
    return [
        {
            "picture [px]": f"{row.width_px} × {row.height_px}",
            "drawn": row.drawn,
            "median [ms]": f"{1000.0 * row.median_s:.1f}",
            "5–95 % [ms]": f"{1000.0 * row.low_s:.0f}–{1000.0 * row.high_s:.0f}",
            "CPU [ms]": f"{1000.0 * row.processor_s:.1f}",
            "of full": f"{100.0 * row.share:.0f} %",
            "at most [ms]": "–" if row.bar_s is None else f"{1000.0 * row.bar_s:g}",
            "bar": row.state or "–",
        }
        for row in cost.rows
    ]


def cost_words(cost: CameraCost) -> str:
    """What was drawn, how often and by what."""
    pictures = min(row.pictures for row in cost.rows)
    return (
        f"{pictures} pictures of the moving load of {cost.scene} ({cost.packages} packages), from one simulation, each"
        " drawn at every size and every way before the next. Wall and processor (CPU) time of a picture; of full:"
        f" against the same picture with film and shadows. {cost.processors} processors, {cost.drawn_by}"
    )


def _header(rows: Sequence[SightRow], cost: CameraCost | None) -> str:
    wrong = [row for row in rows if not row.agrees and row.verdict != "unresolved"]
    over = [row for row in rows if row.rms_mm > BARS_MM[row.look]]
    state, badge = ("fail", f"{len(wrong)} WRONG") if wrong else ("pass", "NONE WRONG")
    said = ""
    if rows:
        same, open_ = sum(row.agrees for row in rows), sum(row.verdict == "unresolved" for row in rows)
        said = (
            f'<div class="verdict"><span class="badge">{badge}</span><p>Of {len(rows)} verdicts from pictures {same}'
            f" are the judge's, {open_ or 'none'} stay unresolved,"
            f" {len(wrong) or 'none'} {'are' if len(wrong) > 1 else 'is'} another. RMS error over its bar:"
            f" {len(over) or 'none'} of {len(rows)} tests.</p></div>"
        )
    slow = [row for row in cost.rows if row.state in ("over", "unresolved")] if cost is not None else []
    notices = "".join(
        f'<p class="notice">A picture of {row.width_px} × {row.height_px} took {1000.0 * row.median_s:.0f} ms,'
        f" of which the processor worked {1000.0 * row.processor_s:.0f} ms; it may take"
        f" {1000.0 * (row.bar_s or 0.0):g} ms"
        f"{'. Other work may have got in between: measure again.' if row.state == 'unresolved' else '.'}</p>"
        for row in slow
    )
    return (
        f'<header class="{state if rows else ""}"><p class="kicker">pallet-twin sight</p>'
        "<h1>What the camera measures, and what it costs</h1>"
        "<p>Simulated tests are drawn as the bench's camera sees them, displacement is measured from the pictures"
        " alone and held against the poses that they were drawn from. No picture of a real camera is among them.</p>"
        f"{said}{notices}</header>"
    )


def _worth(rows: Sequence[SightRow], told: Sequence[SightSummary], origin: str) -> list[str]:
    """The sections on error, uncertainty and verdicts."""
    if not rows:
        return [_section("What it measures", _NO_ROWS)]
    open_or_other = [row for row in rows if not row.agrees]
    caption = (
        "Errors are those of one component of one point of a package, displacements up to 300 mm."
        " Filled: root mean square of a test. Hollow: its largest."
    )
    return [
        _section("Error", table(_error_rows(rows, told)) + _figure(level_figure(rows), caption, origin)),
        _section(
            "RMS of a test against its bar",
            _figure(rms_figure(rows), "How many tests have an RMS error of at most so much.", origin)
            + "<h3>Tests over their bar</h3>"
            + table([_test_entry(row) for row in rows if row.rms_mm > BARS_MM[row.look]]),
        ),
        _section(
            "Is the stated uncertainty true?",
            _figure(
                deviation_figure(rows),
                "Errors divided by their stated standard uncertainty, in bins of 0.25; the line is the normal law that"
                " the uncertainty claims, dotted is its 95 %. Narrower than the line: the uncertainty is too large."
                " Errors of one test hang together, so a bin's count says less than it seems.",
                origin,
            ),
        ),
        _section(
            "Verdicts",
            table(_verdict_rows(told))
            + "<h3>Every test that is unresolved or another</h3>"
            + table([_open_entry(row) for row in open_or_other])
            + _origin(origin),
        ),
        _section(
            "Every test",
            f"<details><summary>{len(rows)} tests</summary>{table([_test_entry(row) for row in rows])}</details>"
            + _origin(origin),
        ),
    ]


def _cost(rows: Sequence[SightRow], cost: CameraCost | None, measured: str, timed: str) -> list[str]:
    """The sections on time."""
    taking = (
        "Marks: median over a test's pictures of 1920 × 1080; lines reach to the 95th percentile. Wall time while"
        " the sweep ran, of <code>DisplacementMeasurer.take</code> alone: drawing is not in it."
    )
    drawing = _NO_COST
    if cost is not None:
        caption = (
            f"{escape(cost_words(cost))}. Lines: 5th to 95th percentile. Where the median is"
            " well above processor time, other work got in between."
        )
        drawing = table(cost_table(cost)) + _figure(cost_figure(cost), caption, timed)
    return [
        *(
            [_section("Time to measure a picture", _figure(taking_figure(rows), taking, measured))]
            if rows
            else []
        ),
        _section("Time to draw a picture", drawing),
    ]


def _error_rows(rows: Sequence[SightRow], told: Sequence[SightSummary]) -> list[dict[str, Any]]:
    return [
        {
            "look": LOOK_WORDS[entry.look],
            "tests": entry.scenes,
            "errors compared": f"{sum(row.errors for row in rows if row.look == entry.look):,}".replace(
                ",", " "
            ),
            "RMS [mm]": f"{entry.rms_mm:.2f}",
            "worst test's RMS [mm]": f"{entry.worst_rms_mm:.2f}",
            "at most [mm]": f"{BARS_MM[entry.look]:g}",
            "largest error [mm]": f"{max(row.largest_mm for row in rows if row.look == entry.look):.1f}",
            "inside the stated 95 %": f"{100.0 * entry.coverage:.1f} %",
            "to measure a picture [ms]": f"{entry.take_ms:.0f}",
        }
        for entry in told
    ]


def _verdict_rows(told: Sequence[SightSummary]) -> list[dict[str, Any]]:
    return [
        {
            "look": LOOK_WORDS[entry.look],
            "tests": entry.scenes,
            "as the judge's": entry.same,
            "unresolved": entry.open,
            "another": entry.other,
        }
        for entry in told
    ]


def _open_entry(row: SightRow) -> dict[str, Any]:
    return {
        "test": row.name,
        "look": LOOK_WORDS[row.look],
        "by pictures": row.verdict,
        "by poses": row.judged,
        "rules unresolved": _rules(row.unsettled),
        "rules that differ": _rules(row.missed),
        "RMS [mm]": f"{row.rms_mm:.2f}",
        "inside 95 %": f"{100.0 * row.coverage:.1f} %",
        "tracked": f"{100.0 * row.tracked:.1f} %",
    }


def _test_entry(row: SightRow) -> dict[str, Any]:
    return {
        "test": row.name,
        "look": LOOK_WORDS[row.look],
        "RMS [mm]": f"{row.rms_mm:.2f}",
        "at most [mm]": f"{BARS_MM[row.look]:g}",
        "largest [mm]": f"{row.largest_mm:.1f}",
        "inside 95 %": f"{100.0 * row.coverage:.1f} %",
        "tracked": f"{100.0 * row.tracked:.1f} %",
        "by pictures / by poses": f"{row.verdict} / {row.judged}",
        "to measure [ms], 95 %": f"{row.take_ms:.0f}, {row.slowest_ms:.0f}",
    }


def _rules(names: str) -> str:
    return ", ".join(name.replace("_", " ") for name in names.split()) or "none"


def _figure(svg: str, caption: str, origin: str) -> str:
    return f"<figure>{svg}<figcaption>{caption} {origin}</figcaption></figure>"


def _origin(origin: str) -> str:
    return f'<p class="small">{origin}</p>'


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{content}</section>"
