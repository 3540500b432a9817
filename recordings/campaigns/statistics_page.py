"""The page of a campaign's statistics: one self-contained HTML file for the one who packs the loads.

What follows from the labels is in the physical part, the same bytes for the same labels; what tests took stands behind
it in a section of its own.
"""

from collections.abc import Mapping, Sequence
from html import escape

from config.campaign import Campaign
from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import Cost
from recordings.campaigns.statistics import NEAR, Statistics
from recordings.campaigns.statistics_cost import cost_rows
from recordings.campaigns.statistics_figures import (
    MOST_CURVES,
    colour,
    cost_figure,
    error_figure,
    level_figure,
    margin_figure,
    numerics_figure,
    place_figure,
)
from recordings.campaigns.statistics_groups import Group
from recordings.campaigns.statistics_outliers import OUTLIER_WORDS, Outlier, slowest
from recordings.campaigns.statistics_tables import (
    FIRST_RULES,
    cost_entry,
    counted,
    first_table,
    hours,
    interval,
    margin_entry,
    outlier_table,
    percent,
    place_entry,
    rate_table,
    rule_words,
    three,
)
from sim_core.accuracy.page import table
from sim_core.monitors import MAXIMUM_ENERGY_RESIDUAL
from sim_core.report_style import STYLE

COST_TITLE = "What it took"
_OWN_STYLE = """
.graph{width:120px;min-width:120px}.wide .graph{width:250px}
.key{white-space:nowrap;margin-right:14px}.key.bare{margin:0}
.key::before{content:"";display:inline-block;width:11px;height:11px;margin-right:5px;background:var(--key)}
.rates td,.rates th,.list td{padding:4px 5px;vertical-align:middle}
.rates thead th{font-size:12px}.rates tbody th{min-width:0;max-width:200px}
.two{columns:2 440px;column-gap:32px;font-size:14px}.two>div{break-inside:avoid}
h3{font-size:15px;margin:0 0 2px;padding-top:14px}
.u,.rates .u{white-space:nowrap}.list code{font-size:13px;white-space:nowrap}
"""


def statistics_page(
    statistics: Statistics,
    labels: Sequence[Label],
    campaign: Campaign,
    *,
    refused: Mapping[str, int],
    costs: Mapping[int, Cost],
) -> str:
    """The page as HTML that needs no other file.

    Args:
        statistics: see ``campaign_statistics``.
        labels: what they were made from, by number.
        campaign: theirs.
        refused: refused draws by reason.
        costs: by number; may be empty.
    """
    by_key = {group.key: group for group in statistics.groups}
    sections = [
        *_rate_sections(statistics, labels, by_key),
        *_failure_sections(statistics, labels),
        *_margin_sections(statistics, labels),
        _outlier_section(statistics.outliers, statistics.outlier_counts, labels),
        _numerics_section(statistics, labels),
        _refused_section(refused),
        _cost_section(labels, costs, statistics.groups, by_key.get("restraint")),
    ]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(campaign.name)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}{_OWN_STYLE}</style></head><body><main>"
        f"{_header(statistics, labels, campaign, refused)}{''.join(sections)}</main></body></html>\n"
    )


def _header(
    statistics: Statistics, labels: Sequence[Label], campaign: Campaign, refused: Mapping[str, int]
) -> str:
    overall, draws = statistics.overall, sum(refused.values())
    shown, weighted = overall.rate, ""
    if _is_weighted(labels):
        shown = overall.weighted_rate
        weighted = (
            " Tests were chosen by what was expected of them; over the campaign's own ranges"
            f" {percent(overall.weighted_rate)} pass ({interval(overall.weighted_low, overall.weighted_high)} %)."
        )
    rate = (
        f"{percent(overall.rate)} of those that pass or fail ({interval(overall.low, overall.high) or '–'} %)"
    )
    return (
        f'<header><p class="kicker">pallet-twin statistics</p><h1>{escape(campaign.name)}</h1>'
        f"{f'<p class=description>{escape(campaign.description)}</p>' if campaign.description else ''}"
        f'<div class="verdict"><span class="badge">{percent(shown)} PASS</span><p>Of {overall.tests} simulated tests to'
        f" EUMOS 40509, {overall.passes} pass, {rate}; {overall.fails} fail; {overall.unresolved or 'none'}"
        f" {'stays' if overall.unresolved == 1 else 'stay'} unresolved.{weighted}</p>"
        "</div>"
        f'<p class="small">{counted(draws, "draw")} made no test. {counted(statistics.near, "test")}'
        f" came within {100.0 * NEAR:.0f} % of the limit that decides."
        " In brackets: 95 % intervals (Wilson's), for chance in the draws and not for errors of the model.</p></header>"
    )


def _rate_sections(statistics: Statistics, labels: Sequence[Label], by_key: Mapping[str, Group]) -> list[str]:
    is_weighted = _is_weighted(labels)
    key = (
        '<p class="small">Dot and line: passes among passes and fails, with the 95 % interval.'
        + (" Ring: weighted back to the campaign's own ranges." if is_weighted else "")
        + "</p>"
    )
    level, restraint = by_key.get("sled.level_g"), by_key.get("restraint")
    sections = []
    if level is not None and len(level.values) > 1:
        restraint = restraint or statistics.groups[0]
        names = restraint.values[:MOST_CURVES]
        caption = f"{_keys(names)} Lines: 95 % intervals. Tests as they were run, not weighted."
        sections.append(
            _section("Who passes at which level", _figure(level_figure(labels, level, restraint), caption))
        )
    wide, tables, fixed = "", list[str](), list[str]()
    for group in statistics.groups[1:]:
        own = [rate for rate in statistics.rates if rate.group == group.key]
        if len(own) == 1:
            fixed.append(f"{group.title}: {own[0].value}")
            continue
        if group.key == "scheme":
            own.sort(
                key=lambda rate: (
                    -(rate.weighted_rate if rate.weighted_rate is not None else -1.0),
                    rate.value,
                )
            )
        block = f"<h3>{escape(group.title)}</h3>{rate_table(own, is_weighted)}"
        # Schemes are many and their names long.
        wide, tables = (block, tables) if group.key == "scheme" else (wide, [*tables, f"<div>{block}</div>"])
    same = f'<p class="small">The same in all tests: {escape("; ".join(fixed))}.</p>' if fixed else ""
    body = f'{key}<div class="wide">{wide}</div><div class="two">{"".join(tables)}</div>{same}'
    sections.append(_section("How many pass", body))
    return sections


def _failure_sections(statistics: Statistics, labels: Sequence[Label]) -> list[str]:
    if not statistics.overall.fails:
        return [_section("What fails first", "<p>No test failed.</p>")]
    tables = []
    for group in statistics.groups:
        own = [row for row in statistics.first_rules if row.group == group.key]
        values = list(dict.fromkeys(row.value for row in own))
        if own and (group.key == "all" or len(group.values) > 1):
            tables.append(f"<div><h3>{escape(group.title)}</h3>{first_table(own, values)}</div>")
    legend = "".join(
        f'<span class="key" style="--key:{colour(place)}">{rule_words(rule)}</span>'
        for place, rule in enumerate(FIRST_RULES)
        if any(row.rule == rule for row in statistics.first_rules)
    )
    origin = (
        "A fail counts for the rule that it broke first; a permanent displacement is broken from the moment after which"
        " it never comes back. Tests as they were run."
    )
    caption = (
        "Left: settled height of the place above the sled's top, as a share of the load's height. Right: from the"
        " first frame, in which the sled stands."
    )
    return [
        _section(
            "What fails first",
            f'<p>{legend}</p><div class="two">{"".join(tables)}</div><p class="small">{origin}</p>',
        ),
        _section(
            "Where and when it begins",
            _figure(place_figure(labels), caption)
            + table([place_entry(place) for place in statistics.places]),
        ),
    ]


def _margin_sections(statistics: Statistics, labels: Sequence[Label]) -> list[str]:
    whole = [label for label in labels if label.ended_by is None]
    rules = [row.rule for row in statistics.margins]
    if not rules:
        return []
    sections = [
        _section(
            "How close to the limits",
            _figure(
                margin_figure(whole, rules),
                "Worst displacement of a test as a share of the limit (dashed), a panel a rule. What is beyond 250 %"
                " stands in the last bar. Tests that a monitor ended are left out.",
            )
            + table([margin_entry(row) for row in statistics.margins]),
        )
    ]
    if any(row.error_mm is not None for row in statistics.margins):
        sections.append(
            _section(
                "Is the error small enough to tell?",
                _figure(
                    error_figure(whole, rules),
                    "Error estimate of each test beside its distance from the limit, whichever side; above the dashed"
                    " line the estimate reaches across the limit and the rule stays unresolved. The larger a mark,"
                    " the more tests.",
                ),
            )
        )
    return sections


def _outlier_section(rows: Sequence[Outlier], counts: Mapping[str, int], labels: Sequence[Label]) -> str:
    by_number = {label.number: label for label in labels}
    lists = []
    for kind in dict.fromkeys((*(row.kind for row in rows), *(kind for kind in counts))):
        own = [row for row in rows if row.kind == kind]
        many = f" ({counts[kind]})" if counts.get(kind) else ""
        lists.append(f"<h3>{OUTLIER_WORDS[kind]}{many}</h3>{outlier_table(own, by_number)}")
    hint = (
        "<p>Each test lies in its folder beside this page. From the page's folder"
        " <code>pallet-twin view PATH</code> shows it and <code>pallet-twin judge PATH</code> judges it again.</p>"
    )
    return _section("Tests worth a look", hint + "".join(lists))


def _numerics_section(statistics: Statistics, labels: Sequence[Label]) -> str:
    rows = [
        {
            "engine": row.engine,
            "tests": row.penetration_mm.tests,
            "step, median [ms]": f"{1000.0 * row.time_step_s.median:.3g}",
            "deepest contact, median (95 %, largest) [mm]": three(row.penetration_mm, 1.0),
            "energy from nowhere, median (95 %, largest) [%]": three(row.energy_residual, 100.0),
            "ended by a monitor": row.ended,
            "without an error estimate": row.without_estimate,
        }
        for row in statistics.numerics
    ]
    caption = (
        "The worst moment of each test, attempts that were taken back included. Dashed: beyond it a test goes back and"
        " halves its step, or is ended where that does not help."
    )
    return _section(
        "Can the numbers be trusted?",
        _figure(numerics_figure(labels, MAXIMUM_ENERGY_RESIDUAL), caption) + table(rows),
    )


def _refused_section(refused: Mapping[str, int]) -> str:
    if not refused:
        return ""
    most = sorted(refused.items(), key=lambda item: (-item[1], item[0]))
    rows = [{"draws": count, "why": reason} for reason, count in most[:10]]
    more = f'<p class="small">And {len(most) - 10} more reasons: refused.json.</p>' if len(most) > 10 else ""
    return _section("Draws that made no test", table(rows) + more)


def _cost_section(
    labels: Sequence[Label], costs: Mapping[int, Cost], groups: Sequence[Group], restraint: Group | None
) -> str:
    if not any(label.number in costs for label in labels):
        return _section(COST_TITLE, "<p>costs.parquet holds none of these tests.</p>")
    rows = cost_rows(labels, costs, groups)
    titles = {group.key: group.title for group in groups} | {"packages": "Packages"}
    names = restraint.values[:MOST_CURVES] if restraint is not None else ()
    caption = (
        f"{_keys(names)} Wall time of a test with its error estimate. The larger a mark, the more tests."
    )
    by_number = {label.number: label for label in labels}
    return _section(
        COST_TITLE,
        f"<p>{counted(rows[0].tests, 'test')} took {hours(rows[0].wall_total_s)} of a worker's time,"
        f" {hours(rows[0].process_total_s)} of them on the processor;"
        f" {percent(rows[0].estimate_share)} went into error estimates.</p>"
        + _figure(cost_figure(labels, costs, restraint), caption)
        + table([{"by": titles[row.group], "": row.value, **cost_entry(row)} for row in rows])
        + f"<h3>{OUTLIER_WORDS['slowest']}</h3>{outlier_table(slowest(labels, costs), by_number)}",
    )


def _is_weighted(labels: Sequence[Label]) -> bool:
    return len({label.weight for label in labels}) > 1


def _keys(names: Sequence[str]) -> str:
    return "".join(
        f'<span class="key" style="--key:{colour(place)}">{escape(name)}</span>'
        for place, name in enumerate(names)
    )


def _figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{content}</section>"
