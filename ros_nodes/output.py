"""What the command line shows: progress, verdicts and findings."""

import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from config.scene import Scene
from ros_nodes.one_test import OnProgress, TestOutcome
from ros_nodes.render import Rendered
from sim_core.integrity import Finding
from sim_core.report import Report, report_json
from sim_core.report_film import percent
from sim_core.report_words import tore_film, turns_words

if TYPE_CHECKING:
    from recordings.measure_bag import MeasuredBag
    from recordings.rescue import Recovery
    from ros_nodes.replay import Replayed
    from sim_core.camera.cost import CameraCost
    from sim_core.stress import StressResult
    from sim_core.vision.sweep import SightSummary

NOT_MET = 4
ENDED_BY_MONITOR = 3
_STYLES = {"pass": "bold green", "fail": "bold red", "unresolved": "bold yellow", "off": "dim"}


@contextmanager
def progress(scene: Scene, *, quiet: bool) -> Iterator[OnProgress | None]:
    """A progress bar over simulated time, on standard error, with the rules' states as they change."""
    if quiet:
        yield None
        return
    from sim_core.run import expected_end_s

    end_s = expected_end_s(scene)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[time]:.2f} s simulated"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[rules]}"),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task(scene.name, total=end_s, time=0.0, rules="")

        def advance(time_s: float, states: dict[str, str]) -> None:
            drawn = states.get("pictures")
            broken = [rule for rule, state in states.items() if state != "pass" and rule != "pictures"]
            rules = f"not passing: {', '.join(broken)}" if broken else ""
            rules = f"picture {drawn}  {rules}" if drawn else rules
            bar.update(task, completed=min(time_s, end_s), time=time_s, rules=rules)

        yield advance


@contextmanager
def counter(title: str, *, quiet: bool) -> Iterator[Callable[[int, int, object], None] | None]:
    """A progress bar over rows, on standard error."""
    if quiet:
        yield None
        return
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task(title, total=None)
        yield lambda done, total, _row: bar.update(task, completed=done, total=total)


@contextmanager
def played(*, quiet: bool) -> Iterator[Callable[[float, float, int], None] | None]:
    """A progress bar over a recording's time, on standard error."""
    if quiet:
        yield None
        return
    with Progress(
        TextColumn("replay"), BarColumn(), TextColumn("{task.fields[words]}"), TimeElapsedColumn(),
        console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task("replay", total=None, words="")

        def advance(played_s: float, duration_s: float, messages: int) -> None:
            words = f"{played_s:.2f} of {duration_s:.2f} s, {messages} messages"
            bar.update(task, completed=min(played_s, duration_s), total=duration_s, words=words)

        yield advance


def show_replayed(replayed: "Replayed", *, as_json: bool) -> None:
    """What was played, how well in time, and what came of it anew; ends with 4 where that is something else."""
    from ros_nodes.replay import replay_lines

    if as_json:
        told = {**vars(replayed), "bag": str(replayed.bag)}
        print(report_json({**told, "compared": [vars(compared) for compared in replayed.compared]}))
    else:
        for line in replay_lines(replayed):
            print(line)
    if any(compared.recorded and not compared.is_equal for compared in replayed.compared):
        sys.exit(NOT_MET)


def show_stress(results: "Sequence[StressResult]", out: Path | None, *, as_json: bool) -> None:
    """The stability table; ends the process with 1 when a row is wrong that is not known to be."""
    if as_json:
        print(report_json({"rows": [asdict(result) for result in results]}))
    else:
        console = Console(highlight=False)
        for result in results:
            style = {"wrong": "bold red", "right": "green"}.get(result.outcome, "yellow")
            console.print(
                Text.assemble(
                    f"{result.row} ({result.engine}): ",
                    (result.outcome, style),
                    f": {' '.join(result.measured.split())}",
                ),
                soft_wrap=True,
            )
        tally = Counter(result.outcome for result in results)
        print(", ".join(f"{count} {outcome}" for outcome, count in sorted(tally.items())))
        if out is not None:
            print(f"page    {out / 'stress.html'}")
    if any(not result.is_acceptable and result.known_wrong is None for result in results):
        sys.exit(1)


def finish(outcome: TestOutcome, *, as_json: bool, require: str | None) -> None:
    """Shows a finished test and ends the process where its outcome asks for a code other than 0."""
    paths = {
        "report": str(outcome.where.report),
        "page": str(outcome.where.page) if outcome.where.page is not None else None,
        "bag": str(outcome.where.bag) if outcome.where.bag is not None else None,
        "video": str(outcome.where.video) if "camera" in outcome.report else None,
    }
    if as_json:
        print(report_json({**outcome.report, "paths": paths}))
    else:
        show_rules(outcome.report)
        _show_numerics(outcome.report["numerics"])
        if outcome.report.get("residual", {}).get("packages"):
            told = outcome.report["residual"]
            print(
                f"machine less twin: {told['rms_mm']:.2f} mm rms over {told['points']} points, at most"
                f" {told['largest_mm']:.1f} mm, {told['package']} at {told['largest_at_s']:.2f} s"
            )
        if "classifier" in outcome.report:
            told = outcome.report["classifier"]
            print(
                f"classifier: {told['verdict']}, success {100.0 * told['success_probability']:.1f} %, {told['told']}"
            )
        if "cross_check" in outcome.report:
            _show_cross_check(outcome.report["cross_check"])
        for name, path in paths.items():
            if path is not None:
                print(f"{name:7} {path}")
    if outcome.ended_by is not None:
        print(f"pallet-twin: {outcome.ended_by}", file=sys.stderr)
        sys.exit(ENDED_BY_MONITOR)
    meet(require, outcome.report)


def show_measured(measured: "MeasuredBag", video: Path | None, *, as_json: bool) -> None:
    """What a recording's pictures say, beside the truth where it holds poses."""
    entry, truth = measured.entry, measured.truth
    if as_json:
        beside: dict[str, Any] = {
            "rms_error_mm": None,
            "largest_error_mm": None,
            "coverage": None,
            "points": 0,
            "truth": None,
        }
        if truth is not None:
            beside = {
                "rms_error_mm": truth.rms_error_mm,
                "largest_error_mm": truth.largest_error_mm,
                "coverage": truth.coverage,
                "points": truth.points,
                "truth": {"verdict": truth.verdict, "rules": truth.rules},
            }
        print(report_json({"name": measured.scene.name, **entry, **beside}))
        return
    console = Console(highlight=False)
    console.print(
        Text.assemble(
            f"{measured.scene.name}, by its pictures: ",
            (entry["verdict"].upper(), _STYLES[entry["verdict"]]),
        )
    )
    true = {rule["rule"]: rule for rule in truth.rules} if truth is not None else {}
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("rule", no_wrap=True)
    for column in ("measured mm", "± mm (95 %)", *(("true mm",) if true else ()), "limit mm"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True)
    for rule in entry["rules"]:
        others = [_number(true[rule["rule"]]["worst_mm"], ".1f")] if true else []
        state = rule["state"]
        if true and true[rule["rule"]]["state"] != state:
            state += f" (judge: {true[rule['rule']]['state']})"
        table.add_row(
            rule["rule"].replace("_", " "),
            *(_number(rule[key], ".1f") for key in ("worst_mm", "error_mm")),
            *others,
            _number(rule["limit_mm"], ".1f"),
            Text(state, style=_STYLES[rule["state"]]),
        )
    console.print(table)
    if truth is not None:
        print(
            f"against the poses: RMS error {truth.rms_error_mm:.2f} mm, at most {truth.largest_error_mm:.1f} mm, over"
            f" {truth.points} points; {100.0 * truth.coverage:.1f} % inside the stated 95 %"
        )
    for line in entry["unseen"]:
        print(f"not seen: {line}")
    if video is not None:
        print(f"video   {video}")


def show_sight(summaries: "Sequence[SightSummary]") -> None:
    """How well displacement is measured from pictures, a look a line."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("look", no_wrap=True)
    for column in (
        "scenes",
        "RMS mm",
        "worst\nRMS mm",
        "inside\n95 %",
        "same\nverdict",
        "unresolved",
        "other",
        "ms a\npicture",
    ):
        table.add_column(column, justify="right")
    for entry in summaries:
        table.add_row(
            entry.look, str(entry.scenes), f"{entry.rms_mm:.2f}", f"{entry.worst_rms_mm:.2f}",
            f"{100.0 * entry.coverage:.1f} %", str(entry.same), str(entry.open), str(entry.other),
            f"{entry.take_ms:.0f}",
        )  # fmt: skip
    Console(highlight=False).print(table)


def show_picture_cost(cost: "CameraCost") -> None:
    """What a picture takes to be drawn, a size and a way of drawing a line."""
    from sim_core.vision.sight_page import cost_table, cost_words

    rows = cost_table(cost)
    table = Table(box=None, pad_edge=False, header_style="dim")
    for number, name in enumerate(rows[0]):
        justify: Literal["left", "right"] = "left" if number < 2 else "right"
        widest = max(map(len, name.split()))
        table.add_column(Text(name), justify=justify, min_width=widest, no_wrap=number < 2)
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    Console(highlight=False).print(table)
    print(cost_words(cost))


def show_recovery(recovery: "Recovery", *, as_json: bool) -> None:
    """What was saved of a broken recording, and what is missing."""
    if as_json:
        print(report_json(json.loads(json.dumps(asdict(recovery), default=str))))
        return
    for line in recovery.lines():
        print(line)


@contextmanager
def fitting(*, quiet: bool) -> Iterator[Callable[[int, float], None] | None]:
    """The number of simulations and the best fit so far, on standard error."""
    if quiet:
        yield None
        return
    with Progress(
        TextColumn("fitting"), TextColumn("{task.fields[words]}"), TimeElapsedColumn(),
        console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task("fitting", total=None, words="")

        def advance(simulations: int, best_mm: float) -> None:
            bar.update(task, words=f"{simulations} simulations, {best_mm:.2f} mm rms left at best")

        yield advance


def show_lines(lines: Iterable[str], entry: Mapping[str, Any], *, as_json: bool) -> None:
    """A result as lines, or as JSON."""
    if as_json:
        print(report_json(dict(entry)))
        return
    for line in lines:
        print(line)


def show_drawn(drawn: Rendered, *, as_json: bool) -> None:
    """Says what was drawn anew, and where it stands."""
    if as_json:
        print(report_json({**asdict(drawn), "bag": str(drawn.bag), "video": str(drawn.video)}))
        return
    print(f"{drawn.pictures} pictures drawn by {drawn.drawn_by}")
    print(f"bag     {drawn.bag}")
    print(f"video   {drawn.video}")


def meet(require: str | None, report: Report) -> None:
    """Ends the process with 4 when a verdict was required and is another."""
    if require is not None and report["verdict"] != require:
        print(f"pallet-twin: verdict = {report['verdict']}: {require} was required", file=sys.stderr)
        sys.exit(NOT_MET)


def show_rules(report: Report) -> None:
    """The verdict, its rules and the worst package."""
    console = Console(highlight=False)
    verdict = report["verdict"]
    console.print(Text.assemble(f"{report['name']}: ", (verdict.upper(), _STYLES[verdict])))
    if not report["rules"]:
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("rule", no_wrap=True)
    for column in ("worst mm", "± mm", "limit mm"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True)
    table.add_column("where", overflow="fold")
    for rule in report["rules"]:
        table.add_row(
            rule["rule"].replace("_", " "),
            *(_number(rule[key], ".1f") for key in ("worst_mm", "error_mm", "limit_mm")),
            Text(rule["state"], style=_STYLES[rule["state"]]),
            Text(_where(report, rule)),
        )
    console.print(table)
    if report["packages"]:
        worst = max(report["packages"], key=lambda package: package["peak_mm"])
        console.print(
            Text(
                f"worst package {worst['id']}: peak {worst['peak_mm']:.1f} mm,"
                f" permanent {worst['permanent_mm']:.1f} mm,"
                f" tilt {worst['final_tilt_deg']:.1f} deg"
            )
        )
    for line in film_lines(report):
        print(line)


def show_check(findings: Sequence[Finding], facts: Mapping[str, Any], *, as_json: bool) -> None:
    """Findings and facts of a check; ends the process with 2 when an error is among them."""
    errors = sum(finding.severity == "error" for finding in findings)
    if as_json:
        print(report_json({**facts, "findings": [asdict(finding) for finding in findings], "errors": errors}))
    else:
        for name, value in facts.items():
            if not isinstance(value, (list, dict)):
                print(f"{name:14} {value}")
        for finding in findings:
            print(
                f"{finding.severity}: {finding.check} of {finding.subject} = {finding.value}: {finding.limit}"
            )
        print("refused" if errors else "fit to be tested" if "packages" in facts else "whole")
    if errors:
        sys.exit(2)


def _show_numerics(numerics: Mapping[str, Any]) -> None:
    error = numerics["error_estimate_mm"]
    estimate = f"error estimate {error:.2f} mm" if error is not None else "no error estimate"
    if numerics["within_tolerance"] is False:
        estimate += f", above the tolerance of {numerics['tolerance_mm']:g} mm"
    print(
        f"{estimate} ({numerics['error_estimate_from']}); engine {numerics['engine']},"
        f" step {1000.0 * numerics['time_step_s']:.3f} ms x {numerics['iterations']} iterations;"
        f" {numerics['simulated_s']:.2f} s simulated in {numerics['wall_time_s']:.2f} s,"
        f" {numerics['real_time_factor']:.2f} x real time"
    )
    if numerics["refinements"]:
        print(
            f"made finer after {', '.join(numerics['refinements'])}; began with {numerics['setting_chosen']}"
        )
    elif numerics["tolerance_mm"] is not None:
        print(numerics["setting_chosen"])
    for line in numerics["unmet_friction"]:
        print(f"friction not met: {line}")
    if "pace" in numerics:
        print(numerics["pace"])


def _show_cross_check(check: Mapping[str, Any]) -> None:
    if check["problem"] is not None:
        print(f"cross-check: {check['engine']} gave no answer: {check['problem']}")
        return
    worst = ", ".join(
        f"{entry['rule'].replace('_', ' ')} {entry['worst_mm']:.1f} mm"
        for entry in check["rules"]
        if entry["worst_mm"] is not None
    )
    print(f"cross-check: {check['engine']} {'agrees' if check['agrees'] else 'DISAGREES'}: {worst}")


def film_lines(report: Report) -> list[str]:
    """How the film of a wrapped load fared; no line where there is none.

    Args:
        report: a full report, or a judgement alone, which has less to say.
    """
    film, wrap = report.get("film"), report.get("wrap")
    if wrap is None:
        if film is None or not film["peak_strain"]:
            return []
        torn = sum(time_s >= 0.0 for time_s in film["torn_s"])
        fate = f"{torn} of {len(film['torn_s'])} elements torn" if torn else "not torn"
        return [f"film: largest strain {percent(max(film['peak_strain']))}; {fate}"]
    limits = f"breaks at {percent(wrap['break_strain'])}"
    if wrap.get("yield_strain") is not None:
        limits = f"yields at {percent(wrap['yield_strain'])}, {limits}"
    fate = "not torn"
    if wrap["torn"]:
        fate = f"{wrap['torn']} of {wrap['elements']} elements torn, first {_film_place(wrap, 'first_tear')}"
    held = ", which follows and does not hold" if wrap["coupling"] == "one_way" else ""
    return [
        f"film {wrap['material']}, {turns_words(wrap['turns'])}{held}: largest strain {percent(wrap['peak_strain'])}"
        f" ({limits}), {_film_place(wrap, 'peak')}; {fate}",
        f"film pulls {wrap['start_force_npm']:.0f} N/m when settled and {wrap['peak_force_npm']:.0f} N/m at most;"
        f" lost {wrap['lost_j']:.3g} J",
    ]


def _film_place(wrap: Mapping[str, Any], what: str) -> str:
    x, y, z = wrap[f"{what}_position_m"]
    return f"x {x:.2f} y {y:.2f} z {z:.2f} m at {wrap[f'{what}_time_s']:.2f} s"


def _where(report: Report, rule: Mapping[str, Any]) -> str:
    if rule["package"] is None:
        return "-"
    if tore_film(report, rule):
        return f"film torn, {rule['height_m']:.2f} m high, first at {rule['time_s']:.2f} s"
    return f"{rule['package']}, {rule['height_m']:.2f} m high, at {rule['time_s']:.2f} s"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
