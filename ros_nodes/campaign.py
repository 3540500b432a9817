"""``pallet-twin campaign``: makes thousands of labelled tests, and shows how far it is."""

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from config.campaign import Campaign, read_campaign
from config.errors import RefusedInput
from config.shipped import CAMPAIGNS

if TYPE_CHECKING:
    from recordings.campaigns.driver import Standing
    from recordings.campaigns.workers import Workers


def make_campaign(
    name: str,
    out: Path | None,
    *,
    overrides: list[str],
    workers: int | None,
    address: str | None,
    at_most: int | None,
    quiet: bool,
) -> dict[str, Any]:
    """Runs a campaign, or what is missing of it, and says what there is.

    Args:
        name: campaign file, or name of a shipped one.
        out: folder, by default ``runs/NAME``.
        overrides: ``key=value`` texts.
        workers: processes, by default one for each core.
        address: of a Ray cluster; then that runs the tests.
        at_most: only so many of its tests.
        quiet: no progress bar.

    Raises:
        RefusedInput: campaign, folder or cluster cannot be used.
        DiskFull: the room ended on the way.
    """
    from recordings.campaigns.drafts import Drafts
    from recordings.campaigns.driver import run_campaign
    from recordings.campaigns.store import CampaignFolder

    path = CAMPAIGNS.find(name)
    campaign = read_campaign(path, overrides)
    # What cannot be drawn at all is told before a folder is made.
    bad = Drafts(campaign, path.parent).bad_loads
    folder_path = out if out is not None else Path("runs") / campaign.name
    with CampaignFolder(folder_path, campaign) as folder, _workers(workers, address) as hands:
        with _bar(campaign, quiet=quiet) as tell:
            standing = run_campaign(campaign, path.parent, folder, hands, at_most=at_most, on_progress=tell)
        refused = [asdict(folder.refused[number]) for number in sorted(folder.refused)]
    return {
        "campaign": campaign.name,
        "folder": str(folder_path),
        **{key: value for key, value in asdict(standing).items() if key not in ("last", "running")},
        "tests_a_minute": 60.0 * standing.rate_hz,
        "bad_files": bad,
        "refused_draws": refused,
    }


def checked_campaign(name: str, overrides: list[str], draws: int) -> dict[str, Any]:
    """What a campaign would draw: its first draws, checked, without running any.

    Raises:
        RefusedInput: the campaign cannot be used.
    """
    from recordings.campaigns.drafts import Draft, Drafts

    path = CAMPAIGNS.find(name)
    campaign = read_campaign(path, overrides)
    drafts = Drafts(campaign, path.parent)
    last = draws if drafts.count is None else min(draws, drafts.count)
    found = [drafts.draft(number) for number in range(last)]
    refused = [asdict(draft) for draft in found if not isinstance(draft, Draft)]
    packages = [len(draft.scene.packages) for draft in found if isinstance(draft, Draft)]
    return {
        "campaign": campaign.name,
        "tests": drafts.count if drafts.count is not None else campaign.tests,
        "checked": last,
        "refused_draws": refused,
        "bad_files": drafts.bad_loads,
        "packages": [min(packages), max(packages)] if packages else [],
    }


@contextmanager
def _workers(count: int | None, address: str | None) -> "Iterator[Workers]":
    from recordings.campaigns.workers import ProcessWorkers

    if count is not None and address is not None:
        raise RefusedInput(
            "--workers", count, "is for this machine; a cluster at --address says itself what it has"
        )
    if address is not None:
        from recordings.campaigns.ray_workers import RayWorkers

        hands: Workers = RayWorkers(address)
    else:
        hands = ProcessWorkers(count if count is not None else len(os.sched_getaffinity(0)))

    try:
        yield hands
    finally:
        hands.close()


@contextmanager
def _bar(campaign: Campaign, *, quiet: bool) -> "Iterator[Any]":
    if quiet:
        yield None
        return
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[told]}"),
        console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task(campaign.name, total=None, told="")
        last: str | None = None

        def tell(standing: "Standing") -> None:
            nonlocal last
            bar.update(task, completed=standing.done, total=standing.wanted, told=in_words(standing))
            if standing.last is not None and standing.last != last:
                last = standing.last
                bar.console.print(f"refused: {last}", style="yellow", highlight=False)

        yield tell


def in_words(standing: "Standing") -> str:
    """Class balance, rate and time left, in one line."""
    told = f"{standing.passes} pass, {standing.fails} fail, {standing.unresolved} unresolved"
    told += f", {standing.refused} refused" if standing.refused else ""
    if standing.left_s is None:
        return told
    minutes, seconds = divmod(round(standing.left_s), 60)
    hours, minutes = divmod(minutes, 60)
    left = f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {seconds:02d} s"
    return f"{told}; {60.0 * standing.rate_hz:.1f} a minute, {left} left"


def campaign(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A campaign file, or a shipped campaign: paper, smoke.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the tests; continued if it exists. Default: runs/NAME."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the campaign. May be repeated."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Tests at once. Default: as many as there are cores.")
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="A Ray cluster to run on, or auto; needs pallet-twin[cluster]."
        ),
    ] = None,
    at_most: Annotated[
        int | None, typer.Option("--at-most", min=1, help="Only so many of its tests; a later run goes on.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Run nothing: draw the first hundred tests and check them.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Make thousands of labelled tests: each a bag with its pictures, and a row that says pass or fail, and why.

    The campaign file says what is drawn. The same file gives the same bytes, whatever number of workers makes them.
    End it at any moment: the same command goes on, and never counts half a test. DIR/labels.parquet is the table of
    labels; `pallet-twin statistics DIR` shows it, `pallet-twin verify DIR` holds it against the bags.

    Exits with 2 where a palletising file or a draw was refused: the others are done all the same.

    Examples: `pallet-twin campaign smoke`, `pallet-twin campaign paper --set tests=300 --out runs/paper-300`.
    """
    if check:
        result = checked_campaign(file, set_ or [], 100)
    else:
        result = make_campaign(
            file, out, overrides=set_ or [], workers=workers, address=address, at_most=at_most, quiet=as_json
        )
    _show(result, as_json=as_json)
    if result["bad_files"]:
        raise typer.Exit(2)


def _show(result: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(result, indent=1, ensure_ascii=False))
        return
    if "done" in result:
        print(f"tests   {result['done']} of {result['wanted']}, {result['new']} of them new")
        told = f"labels  {result['passes']} pass, {result['fails']} fail, {result['unresolved']} unresolved"
        settled = result["passes"] + result["fails"]
        print(
            f"{told}; {100.0 * result['passes'] / settled:.1f} % of the settled ones pass"
            if settled
            else told
        )
        if result["new"]:
            print(f"rate    {result['tests_a_minute']:.1f} tests a minute in this run")
        print(f"table   {result['folder']}/labels.parquet")
    else:
        least, most = result["packages"] or (0, 0)
        print(
            f"checked {result['checked']} of {result['tests']} tests: {least} to {most} packages and sheets each"
        )
    for reason in result["bad_files"].values():
        print(f"skipped {reason}", file=sys.stderr)
    others = [
        draft for draft in result["refused_draws"] if draft["reason"] not in result["bad_files"].values()
    ]
    for draft in others[:5]:
        print(f"refused draw {draft['number']}: {draft['reason']}", file=sys.stderr)
    if len(others) > 5:
        print(f"refused {len(others) - 5} draws more; all stand in refused.json", file=sys.stderr)


def verify(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a campaign.")],
    share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Of the tests to run again at half the step; 0 for none.")
    ] = 0.01,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Hold a campaign's labels against its bags: bytes, verdicts, first failures; and a sample against finer runs.

    Exits with 3 where something contradicts a label.
    """
    from recordings.campaigns.verify import verify_campaign
    from ros_nodes.output import counter

    with counter("verified", quiet=as_json) as count:
        found = verify_campaign(folder, share=share, on_progress=count)
    if as_json:
        print(json.dumps({**asdict(found), "holds": found.holds}, indent=1))
    else:
        print(
            f"bags    {found.bags} judged again, {len(found.damaged)} damaged, {len(found.rejudged)} otherwise"
        )
        told = f"finer   {found.finer} run at half the step, {len(found.disagreeing)} otherwise"
        print(f"{told}, {found.finer_unresolved} were unresolved")
        for what, mismatches in (
            ("damaged", found.damaged), ("judged", found.rejudged), ("finer", found.disagreeing),
        ):  # fmt: skip
            for mismatch in mismatches[:5]:
                print(
                    f"{what} {mismatch.number}: label {mismatch.label}, found {mismatch.found}",
                    file=sys.stderr,
                )
    if not found.holds:
        raise typer.Exit(3)


def scaling(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A campaign file, or a shipped one.")] = "paper",
    tests: Annotated[
        int, typer.Option(min=16, max=4096, help="How many of its tests, a multiple of 16.")
    ] = 32,
    workers: Annotated[
        int, typer.Option(min=2, max=1024, help="Tests at once, where there are several.")
    ] = 2,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Measure what running a campaign costs beside its tests: one process, several, and Ray where it is installed.

    All run the same tests in turn, so compare the ratios: the machine should have as many free cores as workers.
    """
    from importlib.util import find_spec

    from recordings.campaigns.scaling import as_entry, measure_scaling
    from ros_nodes.output import counter

    if tests % 16:
        raise RefusedInput("--tests", tests, "must be a multiple of 16")
    path = CAMPAIGNS.find(file)
    own = read_campaign(path)
    with counter("tests", quiet=as_json) as count:
        rows = measure_scaling(
            own,
            path.parent,
            tests=tests,
            workers=workers,
            with_ray=find_spec("ray") is not None,
            on_progress=count,
        )
    entries = [as_entry(row, rows[0]) for row in rows]
    if as_json:
        print(json.dumps(entries, indent=1))
        return
    print(f"{'':20}{'tests a minute':>16}{'times one':>12}{'beside tests':>14}{'growth':>8}  bytes")
    for entry in entries:
        print(
            f"{entry['hands']:20}{entry['tests_a_minute']:16.2f}{entry['times_one_process']:12.2f}"
            f"{100.0 * entry['beside_the_tests']:12.1f} %{entry['growth']:8.2f}"
            f"  {'the same' if entry['same_bytes'] else 'OTHERS'}"
        )
