"""The stability table on disk: JSON for machines, CSV for spreadsheets, one self-contained page for people."""

import csv
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from config.errors import RefusedInput
from sim_core.report_style import STYLE
from sim_core.stress.model import StressResult

_COLUMNS = (
    "row", "engine", "group", "title", "outcome", "is_acceptable", "measured", "value", "bound", "unit", "wall_s",
    "known_wrong", "expected",
)  # fmt: skip
# Shapes as well as colours: a printed or colour-blind reading keeps the meaning.
_MARKS = {"right": "✓", "refused": "⊘", "ended": "■", "wrong": "✗"}
_MEANINGS = {
    "right": "within its stated bound",
    "refused": "before the first step, by field, value and limit",
    "ended": "by a monitor, with partial results",
    "wrong": "a normal-looking wrong number: a defect",
}
_OWN_STYLE = """
.mark{font-weight:700;white-space:nowrap;padding:1px 8px;border-radius:4px;border:1px solid currentColor}
.right{color:var(--good);background:var(--good-fill)}.refused{color:var(--ink);background:transparent}
.ended{color:var(--open);background:var(--open-fill)}.wrong{color:var(--bad);background:var(--bad-fill)}
.group th{font-size:16px;padding-top:18px;color:var(--ink)}
header.clean{border-top-color:var(--good)}header.defect{border-top-color:var(--bad)}
"""


def write_results(out: Path, results: Sequence[StressResult]) -> None:
    """Writes ``stress.json``, ``stress.csv`` and ``stress.html`` into a folder.

    Raises:
        RefusedInput: the folder cannot be written.
    """
    plain = [_plain(asdict(result)) for result in results]
    try:
        text = json.dumps({"version": 1, "rows": plain}, indent=1, ensure_ascii=False, allow_nan=False)
        (out / "stress.json").write_text(text + "\n", encoding="utf-8")
        with (out / "stress.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, _COLUMNS, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(plain)
        (out / "stress.html").write_text(stress_page(results), encoding="utf-8")
    except OSError as error:
        raise RefusedInput("out", str(out), error.strerror or "cannot be written") from None


def stress_page(results: Sequence[StressResult]) -> str:
    """The table as one HTML page without outside references."""
    counts = Counter[str](result.outcome for result in results)
    defects = [result for result in results if result.outcome == "wrong"]
    summary = ", ".join(f"{counts[name]} {name}" for name in _MARKS if counts[name])
    legend = "".join(f"<li>{_mark(name)} {escape(meaning)}</li>" for name, meaning in _MEANINGS.items())
    body = "".join(
        f'<tr class="group"><th colspan="5">{escape(group)}</th></tr>' + "".join(map(_table_row, members))
        for group, members in groupby(results, key=lambda result: result.group)
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1"><title>Stress table</title>'
        f"<style>{STYLE}{_OWN_STYLE}</style></head><body><main>"
        f'<header class="{"defect" if defects else "clean"}"><p class="kicker">pallet-twin stress</p>'
        f"<h1>Stability on stiff and extreme cases</h1><p>{len(results)} rows: {escape(summary)};"
        f" {sum(result.wall_s for result in results):.0f} s in all.</p><ul>{legend}</ul></header>"
        '<section><div class="scroll"><table><thead><tr><th>case</th><th>expected</th><th>outcome</th>'
        '<th>measured</th><th class="n">wall s</th></tr></thead>'
        f"<tbody>{body}</tbody></table></div></section></main></body></html>\n"
    )


def _table_row(result: StressResult) -> str:
    known = f'<p class="small">known: {escape(result.known_wrong)}</p>' if result.known_wrong else ""
    odd = "" if result.is_acceptable else '<p class="small">not acceptable here</p>'
    return (
        f'<tr><th>{escape(result.title)}<p class="small">{escape(result.row)} · {escape(result.engine)}</p></th>'
        f"<td>{escape(result.expected)}</td><td>{_mark(result.outcome)}{odd}</td>"
        f'<td>{escape(result.measured)}{known}</td><td class="n">{result.wall_s:.2f}</td></tr>'
    )


def _mark(outcome: str) -> str:
    return f'<span class="mark {outcome}">{_MARKS[outcome]} {outcome}</span>'


def _plain(value: Any) -> Any:
    """JSON has no NaN and no infinity: a value that is neither number nor bound becomes null."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
