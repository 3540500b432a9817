"""What the optional parts cost, as a table: JSON for machines, CSV for spreadsheets, Markdown for people."""

import csv
import json
import os
import platform
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from config.scene import Scene
from ros_nodes.parts import PARTS, OptionalPart, Variant
from ros_nodes.parts_run import Graph, Run

METHOD = (
    "Every run is a fresh process; the rows take turns (a b c a b c ...), so that noise of the machine hits all"
    " alike. Times are medians with the smallest and the largest. Times relative to `bare` are the median of the"
    " rounds' own ratios. `loop` is the test itself, from building the load to its end; `process` adds the"
    " interpreter, imports and writing the report, and waits for what runs beside."
    " Force fields change the motion, and with it when the load rests and how many contacts there are, so loops are"
    " compared for each simulated second as well. What runs beside takes a core of its own where there is one."
    " Memory is the peak of resident pages. `bare_loop` is the loop written by hand, with no product around it."
)

_HEADINGS = (
    "row", "loop s", "× bare", "simulated s", "× bare for each", "process s", "× bare", "CPU s, + beside",
    "peak MB, + beside", "threads", "modules", "comes in", "nodes / topics",
)  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """A measurement repeated: smallest, median and largest value."""

    minimum: float
    median: float
    maximum: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """The spread of at least one value."""
        return cls(min(values), statistics.median(values), max(values))


@dataclass(frozen=True)
class Row:
    """What one variant came to.

    Attributes:
        name: its name.
        words: what it is.
        process_s: wall time of the whole process [s].
        loop_s: wall time of the test's loop [s].
        process_ratio: the former relative to ``bare`` in the same round.
        loop_ratio: the latter relative to ``bare`` in the same round.
        pace_ratio: loop time for each simulated second relative to ``bare`` in the same round.
        simulated_s: simulated time [s].
        cpu_s: processor time of the process [s], median.
        cpu_beside_s: processor time of the processes that it started [s], median.
        peak_mb: peak resident memory of the process [MB], median.
        peak_beside_mb: that of the largest process that it started [MB], median.
        threads: threads at the end.
        module_count: imported modules.
        modules_added: imported modules that ``bare`` doesn't have.
        comes_in: the packages that these belong to, as far up as ``bare`` hasn't them, the standard library left out.
        graph: nodes and topics that ``up`` would run, computed; None for ``bare_loop``.
        ended_by: the monitor that ended the test, or None.
    """

    name: str
    words: str
    process_s: Spread
    loop_s: Spread
    process_ratio: Spread
    loop_ratio: Spread
    pace_ratio: Spread
    simulated_s: float
    cpu_s: float
    cpu_beside_s: float
    peak_mb: float
    peak_beside_mb: float
    threads: int
    module_count: int
    modules_added: tuple[str, ...]
    comes_in: tuple[str, ...]
    graph: Graph | None
    ended_by: str | None


@dataclass(frozen=True)
class OffCheck:
    """Whether a part leaves no trace while it is off.

    Attributes:
        part: the part's name.
        holds: whether nothing of it was found in any row without it, and all of it in those with it.
        rows_off: the rows without it.
        imported: what was imported nevertheless, as ``row: module``.
        entered: what was called nevertheless, as ``row: function, calls``.
        unseen: what was not found in a row with it, so that its absence elsewhere says nothing.
    """

    part: str
    holds: bool
    rows_off: tuple[str, ...]
    imported: tuple[str, ...]
    entered: tuple[str, ...]
    unseen: tuple[str, ...]


@dataclass(frozen=True)
class LoopExtra:
    """Calls of one function in the loop: how many more, and their time while they are counted [ms]."""

    calls: int
    ms: float


@dataclass(frozen=True)
class PartsTable:
    """The whole measurement.

    Attributes:
        scene: the scene's name.
        scene_sha256: its digest.
        method: how it was measured, in words.
        repeats: timed runs of each row.
        machine: processors, Python and system.
        rows: the rows, ``bare_loop`` and ``bare`` first.
        bare_over_loop: loop time of ``bare`` relative to ``bare_loop`` in the same round.
        fastest_over_loop: the fastest loop of ``bare`` relative to the fastest of ``bare_loop``.
        loop_extra: what the loop of ``bare`` calls beyond the one written by hand, by function.
        off_checks: one for each part that names what it brings.
        graphs: nodes and topics that the started graphs showed, by row.
        omitted: rows left out, and why.
    """

    scene: str
    scene_sha256: str
    method: str
    repeats: int
    machine: dict[str, str]
    rows: tuple[Row, ...]
    bare_over_loop: Spread
    fastest_over_loop: float
    loop_extra: dict[str, LoopExtra]
    off_checks: tuple[OffCheck, ...]
    graphs: dict[str, Graph]
    omitted: dict[str, str]


def table_of(
    scene: Scene,
    variants: Sequence[Variant],
    timed: Mapping[str, Sequence[Run]],
    traced: Mapping[str, Run],
    shown: Mapping[str, Graph],
    omitted: Mapping[str, str],
) -> PartsTable:
    """Works the runs up into the table.

    Args:
        scene: the user's scene.
        variants: the rows, ``bare`` among them.
        timed: timed runs by row, as many for each, in the order of the rounds.
        traced: one run with its calls counted, by row.
        shown: nodes and topics by row, of the graphs that were started.
        omitted: rows left out, and why.
    """
    bare = timed["bare"]
    return PartsTable(
        scene=scene.name,
        scene_sha256=scene.sha256,
        method=METHOD,
        repeats=len(bare),
        machine={
            "processors": str(os.cpu_count()),
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
        },
        rows=tuple(_row(v, timed[v.name], bare) for v in variants),
        bare_over_loop=_ratio(bare, timed["bare_loop"], lambda run: run.loop_s),
        fastest_over_loop=min(r.loop_s for r in bare) / min(r.loop_s for r in timed["bare_loop"]),
        loop_extra=_loop_extra(traced),
        off_checks=tuple(
            _off_check(part, variants, timed, traced)
            for part in PARTS
            if (part.imports or part.enters) and any(part.name in v.parts for v in variants)
        ),
        graphs=dict(shown),
        omitted=dict(omitted),
    )


def write_tables(table: PartsTable, out: Path) -> None:
    """Writes ``parts.json``, ``parts.csv`` and ``parts.md`` into a folder."""
    (out / "parts.json").write_text(json.dumps(asdict(table), indent=1) + "\n", encoding="utf-8")
    (out / "parts.md").write_text(markdown(table), encoding="utf-8")
    with (out / "parts.csv").open("w", newline="", encoding="utf-8") as stream:
        lines = [_csv_line(row) for row in table.rows]
        writer = csv.DictWriter(stream, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)


def markdown(table: PartsTable) -> str:
    """The table as Markdown, with what holds and how it was measured."""
    lines = [
        f"### What each part of a test costs: `{table.scene}`",
        "",
        f"| {' | '.join(_HEADINGS)} |",
        "|---" * len(_HEADINGS) + "|",
        *map(_line, table.rows),
        "",
        *(f"`{row.name}`: {row.words}.  " for row in table.rows),
        *(f"Left out: {reason}.  " for reason in table.omitted.values()),
        "",
        *_findings(table),
        "",
        f"{table.method} {table.repeats} rounds; {', '.join(f'{k} {v}' for k, v in table.machine.items())}.",
    ]
    return "\n".join(lines) + "\n"


def _findings(table: PartsTable) -> list[str]:
    ratio = table.bare_over_loop
    lines = [
        f"- What is off: `bare` takes {ratio.median:.3f} ({ratio.minimum:.3f} to {ratio.maximum:.3f}) times as long"
        " in its loop as the loop written by hand; the fastest run of each compared:"
        f" {table.fastest_over_loop:.3f} times.",
        "- What it calls beyond that one, with the time while counted: "
        + ", ".join(
            f"`{name}` {extra.calls} × ({extra.ms:.1f} ms)" for name, extra in table.loop_extra.items()
        )
        + ".",
    ]
    for check in table.off_checks:
        found = [*check.imported, *check.entered]
        if check.holds:
            lines.append(
                f"- `{check.part}` off: nothing of it imported or called in {len(check.rows_off)} rows."
            )
        else:
            told = [f"found {entry}" for entry in found] + [f"not seen while on: {e}" for e in check.unseen]
            lines.append(f"- `{check.part}` **leaves a trace**: {'; '.join(told)}.")
    computed = {row.name: row.graph for row in table.rows}
    for name, graph in table.graphs.items():
        predicted = computed[name]
        assert predicted is not None
        silent = sorted(set(graph.topics) - set(predicted.topics))
        lines.append(
            f"- Graph of `{name}`, started: {len(graph.nodes)} nodes, {len(graph.topics)} topics"
            + (
                f", of which silent until somebody listens: {', '.join(f'`{t}`' for t in silent)}."
                if silent
                else "."
            )
        )
    return lines


def _line(row: Row) -> str:
    graph = f"{len(row.graph.nodes)} / {len(row.graph.topics)}" if row.graph is not None else "–"
    cells = (
        f"`{row.name}`" + (" (ended by a monitor)" if row.ended_by else ""),
        _range(row.loop_s),
        f"{row.loop_ratio.median:.2f}",
        f"{row.simulated_s:.2f}",
        f"{row.pace_ratio.median:.2f}",
        _range(row.process_s),
        f"{row.process_ratio.median:.2f}",
        f"{row.cpu_s:.2f}" + (f" + {row.cpu_beside_s:.2f}" if row.cpu_beside_s else ""),
        f"{row.peak_mb:.0f}" + (f" + {row.peak_beside_mb:.0f}" if row.peak_beside_mb else ""),
        str(row.threads),
        str(row.module_count),
        _told(row.comes_in),
        graph,
    )
    return f"| {' | '.join(cells)} |"


def _told(comes_in: Sequence[str]) -> str:
    """The newcomers, with the ROS message packages as a number."""
    messages = [name for name in comes_in if name.endswith("_msgs") or name == "builtin_interfaces"]
    named = [name for name in comes_in if name not in messages]
    return ", ".join(named + ([f"{len(messages)} ROS message packages"] if messages else [])) or "–"


def _range(spread: Spread) -> str:
    return f"{spread.median:.2f} ({spread.minimum:.2f}–{spread.maximum:.2f})"


def _csv_line(row: Row) -> dict[str, object]:
    line: dict[str, object] = {"row": row.name}
    for name in ("process_s", "loop_s", "process_ratio", "loop_ratio", "pace_ratio"):
        spread = getattr(row, name)
        line |= {f"{name}_{key}": round(value, 6) for key, value in asdict(spread).items()}
    for name in ("simulated_s", "cpu_s", "cpu_beside_s", "peak_mb", "peak_beside_mb"):
        line[name] = round(getattr(row, name), 4)
    return line | {
        "threads": row.threads,
        "modules": row.module_count,
        "modules_added": len(row.modules_added),
        "comes_in": " ".join(row.comes_in),
        "nodes": len(row.graph.nodes) if row.graph is not None else "",
        "topics": len(row.graph.topics) if row.graph is not None else "",
        "ended_by": row.ended_by or "",
    }


def _row(variant: Variant, runs: Sequence[Run], bare: Sequence[Run]) -> Row:
    modules, usual = set(runs[0].modules), set(bare[0].modules)
    return Row(
        name=variant.name,
        words=variant.words,
        process_s=Spread.of([run.process_s for run in runs]),
        loop_s=Spread.of([run.loop_s for run in runs]),
        process_ratio=_ratio(runs, bare, lambda run: run.process_s),
        loop_ratio=_ratio(runs, bare, lambda run: run.loop_s),
        pace_ratio=_ratio(runs, bare, lambda run: run.loop_s / run.simulated_s),
        simulated_s=runs[0].simulated_s,
        cpu_s=statistics.median(run.cpu_s for run in runs),
        cpu_beside_s=statistics.median(run.cpu_beside_s for run in runs),
        peak_mb=statistics.median(run.peak_mb for run in runs),
        peak_beside_mb=statistics.median(run.peak_beside_mb for run in runs),
        threads=max(run.threads for run in runs),
        module_count=len(modules),
        modules_added=tuple(sorted(modules - usual)),
        comes_in=tuple(sorted(_newcomers(modules, usual))),
        graph=None if variant.loop_only else computed_graph(variant),
        ended_by=runs[0].ended_by,
    )


def _ratio(runs: Sequence[Run], others: Sequence[Run], of: Callable[[Run], float]) -> Spread:
    return Spread.of([of(run) / of(other) for run, other in zip(runs, others, strict=True)])


def _newcomers(modules: set[str], usual: set[str]) -> set[str]:
    # Cython makes modules of its own as it goes.
    others = {name for name in modules - usual if not name.startswith(("_", "cython_runtime"))}
    topmost = {name for name in others if name.rpartition(".")[0] not in others}
    return {name for name in topmost if name.partition(".")[0] not in sys.stdlib_module_names}


def _loop_extra(traced: Mapping[str, Run]) -> dict[str, LoopExtra]:
    by_hand = traced["bare_loop"].loop_calls
    extra = {
        name: LoopExtra(calls - by_hand.get(name, (0, 0.0))[0], round(1000.0 * seconds, 3))
        for name, (calls, seconds) in traced["bare"].loop_calls.items()
        if calls > by_hand.get(name, (0, 0.0))[0]
    }
    return dict(sorted(extra.items(), key=lambda entry: -entry[1].ms))


def computed_graph(variant: Variant) -> Graph:
    """The nodes that the supervisor would start, itself among them, and the topics that they would send on.

    From the supervisor's own list, the readers that it has each node wait for, and what a bag would hold.
    """
    from msgs_adapters.topics import TWIN_NAMESPACE
    from recordings.test_bag import recorded_topics
    from ros_nodes.readers import readers_wanted
    from ros_nodes.supervisor import Supervisor

    bag = Path("bag") if "with_bag" in variant.options else None
    started = list(Supervisor(variant.scene, "fast", bag).nodes_needed(Path("scene.json")))
    topics = {topic.absolute_name() for topic in recorded_topics(variant.scene)}
    for _, parameters in started:
        for name in readers_wanted(str(parameters.get("readers", ""))):
            topics.add(name if name.startswith("/") else f"{TWIN_NAMESPACE}/{name}")
    return Graph(tuple(sorted(["supervisor", *(name for name, _ in started)])), tuple(sorted(topics)))


def _off_check(
    part: OptionalPart,
    variants: Sequence[Variant],
    timed: Mapping[str, Sequence[Run]],
    traced: Mapping[str, Run],
) -> OffCheck:
    off = tuple(v.name for v in variants if part.name not in v.parts)
    on = [v.name for v in variants if part.name in v.parts]
    imported = tuple(
        f"{row}: {module}"
        for row in off
        for module in timed[row][0].modules
        if any(module == brought or module.startswith(f"{brought}.") for brought in part.imports)
    )
    entered = tuple(
        f"{row}: {function}, {calls} calls"
        for row in off
        for function, calls in traced[row].calls.items()
        if function.startswith(part.enters or ("\0",))
    )
    all_on = {module for row in on for module in timed[row][0].modules}
    called_on = {function for row in on for function in traced[row].calls}
    unseen = tuple(brought for brought in part.imports if brought not in all_on) + tuple(
        entry for entry in part.enters if not any(function.startswith(entry) for function in called_on)
    )
    return OffCheck(part.name, not (imported or entered or unseen), off, imported, entered, unseen)
