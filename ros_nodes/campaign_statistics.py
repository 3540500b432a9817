"""``pallet-twin statistics``: what a campaign's tests came to, as tables, a page and lines."""

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from config.errors import BrokenRecording, RefusedInput
from ros_nodes import output

if TYPE_CHECKING:
    from config.campaign import Campaign
    from recordings.campaigns.one_test import Cost
    from recordings.campaigns.statistics import Statistics

SHOWN = ("scheme", "restraint", "sled.level_g")
"""Groups that the command line shows; the page has all."""


def statistics(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Of a campaign, finished or not.")],
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Tell what a campaign's tests came to: rates, first failures, margins, errors, run time and outliers.

    Writes FOLDER/statistics.html and FOLDER/statistics.parquet, and can be run while the campaign still goes on.

    Example: `pallet-twin statistics runs/my_campaign`.
    """
    found, entry = write_statistics(folder)
    if as_json:
        output.show_lines((), entry, as_json=True)
        return
    _show(found, folder)


def write_statistics(folder: Path) -> "tuple[Statistics, dict[str, Any]]":
    """Writes page and table into a campaign's folder.

    Args:
        folder: of the campaign.

    Returns:
        The statistics, and all of them with the cost as JSON holds them.

    Raises:
        RefusedInput: there is no such folder, no campaign in it, or no finished test yet.
        BrokenRecording: a file of it cannot be read.
    """
    if not folder.is_dir():
        raise RefusedInput("folder", str(folder), "is no folder; pallet-twin campaign makes one")
    if not (folder / "campaign.json").is_file():
        raise RefusedInput("folder", str(folder), "holds no campaign; run pallet-twin campaign first")
    from recordings.campaigns.labels import table_of, write_parquet
    from recordings.campaigns.statistics import as_entry, campaign_statistics
    from recordings.campaigns.statistics_cost import cost_rows
    from recordings.campaigns.statistics_outliers import slowest
    from recordings.campaigns.statistics_page import statistics_page
    from recordings.campaigns.store import read_labels

    campaign, labels = _read_campaign(folder / "campaign.json"), read_labels(folder)
    costs, refused = _read_costs(folder / "costs.parquet"), _read_refused(folder / "refused.json")
    found = campaign_statistics(labels, campaign)
    write_parquet(table_of([as_entry(rate) for rate in found.rates]), folder / "statistics.parquet")
    page = statistics_page(found, labels, campaign, refused=refused, costs=costs)
    scratch = folder / "statistics.html.part"
    scratch.write_text(page, encoding="utf-8")
    scratch.replace(folder / "statistics.html")
    entry = {
        "campaign": campaign.name,
        **as_entry(found),
        "refused": refused,
        "costs": as_entry(cost_rows(labels, costs, found.groups)),
        "slowest": as_entry(slowest(labels, costs)),
        "paths": {"page": str(folder / "statistics.html"), "table": str(folder / "statistics.parquet")},
    }
    return found, entry


def _read_campaign(path: Path) -> "Campaign":
    from config.campaign import campaign_from_raw

    raw = _read_json(path)
    return campaign_from_raw(raw.get("campaign", raw) if isinstance(raw, dict) else raw)


def _read_costs(path: Path) -> "dict[int, Cost]":
    """Costs by number; none where the campaign was killed before it wrote them."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from recordings.campaigns.one_test import Cost

    if not path.is_file():
        return {}
    try:
        rows = pq.read_table(path).to_pylist()
        return {row.pop("number"): Cost(**row) for row in rows}
    except (pa.ArrowException, KeyError, TypeError) as error:
        raise BrokenRecording("costs", str(path), f"is no table of costs: {error}") from None


def _read_refused(path: Path) -> dict[str, int]:
    """Reasons of refused draws with their counts."""
    if not path.is_file():
        return {}
    try:
        reasons = Counter(str(draft["reason"]) for draft in _read_json(path))
    except (KeyError, TypeError):
        raise BrokenRecording("refused", str(path), "is no list of refused draws") from None
    return dict(sorted(reasons.items()))


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BrokenRecording(path.stem, str(path), f"is no JSON: {error}") from None


def _show(found: "Statistics", folder: Path) -> None:
    from recordings.campaigns.statistics import NEAR
    from recordings.campaigns.statistics_outliers import OUTLIER_WORDS
    from recordings.campaigns.statistics_tables import interval, percent

    console = Console(highlight=False)
    shown = [group for group in found.groups if group.key in ("all", *SHOWN)]
    columns = Table(box=None, pad_edge=False, header_style="dim")
    columns.add_column("tests", overflow="fold")
    for name in ("pass", "fail", "unresolved", "rate", "95 %", "weighted"):
        columns.add_column(name, justify="right", no_wrap=True)
    for group in shown:
        if group.key != "all":
            columns.add_row(Text(group.title, style="dim"))
        for rate in (rate for rate in found.rates if rate.group == group.key):
            columns.add_row(
                Text(rate.value), str(rate.passes), str(rate.fails), str(rate.unresolved), percent(rate.rate),
                interval(rate.low, rate.high), percent(rate.weighted_rate),
            )  # fmt: skip
    console.print(columns)
    first = ", ".join(
        f"{row.rule.replace('_', ' ')} {row.fails}" for row in found.first_rules if row.group == "all"
    )
    lines = [f"fails first by: {first or 'no test failed'}"]
    lines.append(f"within {100.0 * NEAR:.0f} % of the limit that decides: {found.near}")
    lines += [f"{OUTLIER_WORDS[kind].lower()}: {count}" for kind, count in found.outlier_counts.items()]
    told: set[str] = set()
    for row in found.outliers:
        if row.kind not in told and row.kind not in found.outlier_counts:
            told.add(row.kind)
            lines.append(
                f"{OUTLIER_WORDS[row.kind].lower()}: {row.told}; pallet-twin view {folder / row.bag}"
            )
    lines += [f"page    {folder / 'statistics.html'}", f"table   {folder / 'statistics.parquet'}"]
    output.show_lines(lines, {}, as_json=False)
