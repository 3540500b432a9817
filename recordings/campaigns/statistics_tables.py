"""The tables on the page of a campaign's statistics."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from recordings.campaigns.labels import RULES, Label
from recordings.campaigns.statistics import NEAR, OTHER_RULE, FirstRule, Place, RuleMargins
from recordings.campaigns.statistics_cost import CostRow
from recordings.campaigns.statistics_figures import colour
from recordings.campaigns.statistics_outliers import Outlier, millimetres
from recordings.campaigns.statistics_rates import Rate, Spread

FIRST_RULES = (*RULES, OTHER_RULE)
"""What can be broken first; the place says the colour."""


def percent(share: float | None) -> str:
    """A share as a table shows it, in one piece."""
    if share is None:
        return "–"
    return ">\u00a01000\u00a0%" if share > 10.0 else f"{100.0 * share:.0f}\u00a0%"


def counted(count: int, noun: str) -> str:
    """A count with its noun."""
    return f"{count or 'No'} {noun}{'' if count == 1 else 's'}"


def interval(low: float | None, high: float | None) -> str:
    """An interval of shares as a table shows it."""
    return "" if low is None or high is None else f"{100.0 * low:.0f}–{100.0 * high:.0f}"


def rate_table(rates: Sequence[Rate], is_weighted: bool) -> str:
    """Rates with a graph each, as an HTML table."""
    head = "<th></th>" + "".join(f"<th class='n'>{name}</th>" for name in ("pass", "fail", "open"))
    head += "<th class='graph'>0 to 100 %</th><th class='n'>rate</th>"
    head += "<th class='n'>weighted</th>" if is_weighted else ""
    body = "".join(
        f"<tr><th{_nowrap(rate.value)}>{escape(rate.value)}</th><td class='n'>{rate.passes}</td>"
        f"<td class='n'>{rate.fails}</td><td class='n'>{rate.unresolved}</td>"
        f"<td class='graph'>{_rate_graph(rate, is_weighted)}</td>"
        f"<td class='n'>{percent(rate.rate)}</td>"
        + (f"<td class='n'>{percent(rate.weighted_rate)}</td>" if is_weighted else "")
        + "</tr>"
        for rate in rates
    )
    return f"<div class='scroll'><table class='rates'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _rate_graph(rate: Rate, is_weighted: bool) -> str:
    """Rate and interval on a line from 0 to 100 %."""
    if rate.rate is None or rate.low is None or rate.high is None:
        return ""
    marks = "".join(f'<path d="M{x} 2V18" stroke="var(--line)"/>' for x in (5, 55, 105, 155, 205))
    ring = ""
    if is_weighted and rate.weighted_rate is not None:
        place = f'cx="{5 + 200 * rate.weighted_rate:.1f}" cy="10" r="7"'
        ring = f'<circle {place} fill="none" stroke="var(--open)" stroke-width="2"/>'
    return (
        f'<svg viewBox="-3 0 216 20" aria-label="{percent(rate.rate)}, {interval(rate.low, rate.high)}">{marks}'
        f'<path d="M{5 + 200 * rate.low:.1f} 10H{5 + 200 * rate.high:.1f}" stroke="var(--good)" stroke-width="3"/>'
        f'{ring}<circle cx="{5 + 200 * rate.rate:.1f}" cy="10" r="4.5" fill="var(--good)"/></svg>'
    )


def first_table(rows: Sequence[FirstRule], values: Sequence[str]) -> str:
    """First rules of some groups' fails, a bar a value, as an HTML table."""
    rules = [rule for rule in FIRST_RULES if any(row.rule == rule for row in rows)]
    body = ""
    for value in values:
        fails = {row.rule: row.fails for row in rows if row.value == value}
        x, parts, total = 0.0, "", sum(fails.values())
        for rule, count in fails.items():
            width = 210.0 * count / total
            parts += f'<rect x="{x:.1f}" y="2" width="{width:.1f}" height="16" fill="{_fill(rule)}"/>'
            x += width
        words = ", ".join(f"{count} {rule_words(rule)}" for rule, count in fails.items())
        counts = "".join(f"<td class='n'>{fails.get(rule, 0) or ''}</td>" for rule in rules)
        body += (
            f"<tr><th{_nowrap(value)}>{escape(value)}</th><td class='n'>{total}</td>"
            f'<td class="graph"><svg viewBox="0 0 210 20" aria-label="{words}">{parts}</svg></td>{counts}</tr>'
        )
    head = "<th></th><th class='n'>fails</th><th class='graph'>first rule</th>" + "".join(
        f'<th class="n" title="{rule_words(rule)}"><span class="key bare" style="--key:{_fill(rule)}"></span></th>'
        for rule in rules
    )
    return f"<div class='scroll'><table class='rates'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _fill(rule: str) -> str:
    return colour(FIRST_RULES.index(rule))


def _nowrap(value: str) -> str:
    return ' class="u"' if len(value) <= 20 else ""


def place_entry(place: Place) -> dict[str, Any]:
    """Where and when, as a table shows it."""
    height, when = place.height_share, place.time_s
    return {
        "first broken": rule_words(place.rule),
        "fails": sum(count for _, count in place.places),
        "height, median (5–95 %)": ""
        if height is None
        else f"{percent(height.median)} ({interval(height.low, height.high)})",
        "time, median (5–95 %) [s]": ""
        if when is None
        else f"{when.median:.2f} ({when.low:.2f}–{when.high:.2f})",
        "what moved": ", ".join(f"{kind} {count}" for kind, count in place.places),
        "most often": "; ".join(
            f"{package} of {scheme} ({count})" for scheme, package, count in place.packages[:3]
        ),
    }


def margin_entry(row: RuleMargins) -> dict[str, Any]:
    """Margins as a table shows them."""
    error = row.error_mm
    return {
        "rule": rule_words(row.rule),
        "tests": row.share.tests,
        "of the limit, 5 %": percent(row.share.low),
        "median": percent(row.share.median),
        "95 %": percent(row.share.high),
        f"within {100.0 * NEAR:.0f} % of it": row.near,
        "error estimate, median (95 %) [mm]": "none"
        if error is None
        else f"{millimetres(error.median)} ({millimetres(error.high)})",
        "estimate reaches across": row.inside_error,
    }


def outlier_table(rows: Sequence[Outlier], by_number: Mapping[int, Label]) -> str:
    """Outliers as an HTML table, with links to their bags and commands."""
    if not rows:
        return "<p>None.</p>"
    body = "".join(
        f'<tr><td class="u"><a href="{row.bag}/">{row.number:05d}</a></td>'
        f"<td>{escape(_load_words(by_number[row.number]))}</td>"
        f'<td><span class="state {escape(row.verdict)}">{escape(row.verdict)}</span></td><td>{escape(row.told)}</td>'
        f"<td><code>pallet-twin view {row.bag}</code></td></tr>"
        for row in rows
    )
    head = "<th>test</th><th>load</th><th>verdict</th><th>why</th><th>to look at it</th>"
    return f"<div class='scroll'><table class='list'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _load_words(label: Label) -> str:
    factors = label.factors
    level = factors.get("sled.level_g")
    words = [str(factors.get("scheme", "")), f"{factors.get('layers', '?')} layers"]
    words += [str(factors.get("restraint") or ""), f"{level:g} g" if isinstance(level, (int, float)) else ""]
    return ", ".join(word for word in words if word)


def cost_entry(row: CostRow) -> dict[str, Any]:
    """Cost as a table shows it."""
    return {
        "tests": row.tests,
        "wall, median (95 %, largest) [s]": three(row.wall_s, 1.0),
        "processor, median (95 %, largest) [s]": three(row.process_s, 1.0),
        "for the estimate": percent(row.estimate_share),
        "simulated s a wall s": f"{row.real_time_factor:.2f}",
        "all": hours(row.wall_total_s),
    }


def hours(seconds: float) -> str:
    """A long time in words."""
    return f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.1f} min"


def three(spread: Spread, factor: float) -> str:
    """Median, 95th percentile and largest in words."""
    return f"{factor * spread.median:.2g} ({factor * spread.high:.2g}, {factor * spread.largest:.2g})"


def rule_words(rule: str) -> str:
    """A rule's name as a reader says it."""
    return rule.replace("_", " ")
