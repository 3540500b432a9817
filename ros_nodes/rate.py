"""``pallet-twin rate``: the largest level that a load passes, or which of its packings passes the largest."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from config.errors import RefusedInput

if TYPE_CHECKING:
    from rich.console import Console

    from sim_core.rating.climb import OnLevel

RESULTS = {"certificate.json", "certificate.html", "rating.json", "rating.csv", "rating.html", "levels"}
_STYLES = {"pass": "green", "fail": "bold red", "unresolved": "bold yellow"}


def rate(
    scene: Annotated[
        str,
        typer.Argument(metavar="SCENE", help="A scene file, a palletising file, or a shipped scene's name."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for the results; continued if it exists. Default: runs/NAME-rate."
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Override a value. May be repeated."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=V1,V2|FILE",
            help="Rate a variant for each value, all combinations of repeated ones; or a JSON file with"
            ' {"KEY": [V1, V2]} or [{"name": "...", "KEY": V}].',
        ),
    ] = None,
    to: Annotated[float, typer.Option(metavar="G", help="Highest level [g], up to 2.")] = 0.8,
    step: Annotated[
        float, typer.Option(metavar="G", help="Halve the last 0.1 g down to this step [g], e.g. 0.025.")
    ] = 0.1,
    all_levels: Annotated[
        bool, typer.Option("--all-levels", help="Test the levels above the first that does not pass, too.")
    ] = False,
    workers: Annotated[
        int, typer.Option(min=0, max=256, help="Tests at once; 0: as many as there are cores.")
    ] = 0,
    date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="Date on the certificate.")] = "",
    institute: Annotated[str, typer.Option(metavar="TEXT", help="Institute on the certificate.")] = "",
    producer: Annotated[str, typer.Option(metavar="TEXT", help="Producer on the certificate.")] = "",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
    ] = False,
) -> None:
    """Step the level to the largest that passes, with a certificate; or rate packing variants against their film.

    From 0.2 g by 0.1 g, until a level does not pass with its error estimate. Levels that DIR holds are not run again.

    Examples: `pallet-twin rate eur_wrap_lldpe --step 0.05 --date 2030-01-31`,
    `pallet-twin rate eur_wrap_lldpe --vary wrap.turns.middle=1,2,3 --vary load.rotate_layers=[],[2,4]`.
    """
    from sim_core.rating import LevelPlan, climb_all, parse_vary, plan_variants
    from sim_core.rating.certificate import Label
    from sim_core.rating.write import LEVELS, write_certificate, write_rating

    plan = LevelPlan(to_g=to, step_g=step, is_whole=all_levels)
    label = Label(date=date, institute=institute, producer=producer)
    variants = plan_variants(scene, set_ or (), parse_vary(vary or ()))
    scenes = [variant.scene for variant in variants if variant.scene is not None]
    name = scenes[0].name
    folder = _folder(out if out is not None else Path("runs") / f"{name}-rate")
    with _progress(name, quiet=as_json) as on_level:
        climbs = climb_all(
            scenes, plan, folder / LEVELS, workers=workers or len(os.sched_getaffinity(0)), on_level=on_level
        )
    if vary:
        entry = write_rating(folder, name, variants, climbs, plan, vary)
        written = ["rating.html", "rating.csv", "rating.json"]
    else:
        entry = write_certificate(folder, climbs[0], plan, label)
        written = ["certificate.html", "certificate.json"]
    _show(entry, [folder / file for file in written], as_json=as_json)


def _folder(folder: Path) -> Path:
    """The folder, made where it is missing.

    Raises:
        RefusedInput: it cannot be made, or holds something else than a rating.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(
            entry.name for entry in folder.iterdir() if entry.name.removesuffix(".part") not in RESULTS
        )
    except OSError as error:
        raise RefusedInput("--out", str(folder), error.strerror or "cannot be made") from None
    if others:
        raise RefusedInput("--out", str(folder), f"holds something else than a rating: {others[0]}")
    return folder


@contextmanager
def _progress(name: str, *, quiet: bool) -> "Iterator[OnLevel | None]":
    """Levels done, of how many at most, and the last one's verdict, on standard error."""
    if quiet:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("levels at most"),
        TimeElapsedColumn(), TextColumn("{task.fields[words]}"), console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task(name, total=None, words="")
        yield lambda done, total, words: bar.update(task, completed=done, total=total, words=words)


def _show(entry: Mapping[str, Any], files: Sequence[Path], *, as_json: bool) -> None:
    from rich.console import Console

    from sim_core.report import report_json

    console = Console(highlight=False, emoji=False)
    if as_json:
        paths = {file.name: str(file) for file in files}
        console.print(report_json({**entry, "paths": paths}), soft_wrap=True, markup=False)
        return
    if "variants" in entry:
        _show_variants(console, entry)
    else:
        _show_levels(console, entry)
    for file in files:
        console.print(
            f"{'page' if file.suffix == '.html' else file.suffix[1:]:7} {file}", soft_wrap=True, markup=False
        )


def _show_levels(console: "Console", entry: Mapping[str, Any]) -> None:
    from rich.text import Text

    state = "pass" if entry["certificate"] else "fail"
    console.print(Text.assemble(f"{entry['scene']}: ", (entry["result"], _STYLES[state])))
    table = _table("level", "verdict", "closest rule", "of the limit", "± mm", "engine and step", "s")
    for level in entry["levels"]:
        share, error = level["share_of_limit"], level["error_estimate_mm"]
        table.add_row(
            f"{level['level_g']:g} g",
            Text(level["verdict"], style=_STYLES[level["verdict"]]),
            (level["closest_rule"] or "-").replace("_", " "),
            "-" if share is None else f"{100.0 * share:.0f} %",
            "-" if error is None else f"{error:.2f}",
            f"{level['engine']} {1000.0 * level['time_step_s']:.4g} ms x {level['iterations']}",
            f"{level['wall_s']:.1f}",
        )
    console.print(table)
    console.print(Text(entry["ended"]))
    console.print("a simulation: verification, not validation")


def _show_variants(console: "Console", entry: Mapping[str, Any]) -> None:
    from rich.text import Text

    table = _table("rank", "passes", "film g", "film kg", "stopped at", "load", "variant")
    for row in entry["variants"]:
        stopped, film_g = row["stopped"], row["film_g"]
        table.add_row(
            str(row["rank"]),
            "none" if row["largest_passed_g"] is None else f"{row['largest_passed_g']:g} g",
            "-" if film_g is None else f"{film_g:.1f}",
            "-" if film_g is None else f"{film_g / 1000.0:.4f}",
            "-" if stopped is None else f"{stopped['level_g']:g} g {stopped['verdict']}",
            f"{row['load']['packages']} x, {row['load']['mass_kg']:g} kg",
            Text(row["name"]),
        )
    console.print(table)
    for row in entry["refused"]:
        console.print(Text(f"not tested: {row['name']}: {row['why']}"), soft_wrap=True)


def _table(*columns: str) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in columns:
        is_words = column in ("verdict", "closest rule", "engine and step", "stopped at", "load", "variant")
        table.add_column(
            column, justify="left" if is_words else "right", overflow="fold", no_wrap=column != "variant"
        )
    return table
