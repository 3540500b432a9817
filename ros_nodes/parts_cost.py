"""What each optional part of a test costs: the same scene with every part on and off, a fresh process each.

Runs as ``python -m ros_nodes.parts_cost`` with a job as JSON on standard input. That process measures what it
imported, so this module itself imports nothing that a test would not.
"""

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from config.errors import EndedByMonitor, Interrupted, RefusedInput
from config.scene import Accelerometer, ForceFields, Sampling, Scene
from config.scene_file import scene_from_json, validate_scene

if TYPE_CHECKING:
    import cProfile

OUR_PACKAGES = ("config", "sim_core", "msgs_adapters", "recordings", "classifier", "ros_nodes", "__main__")
LOOPS = ("sim_core.run:run_test", "__main__:_run_loop")
CO_OPTIMIZED = 0x1


def _nothing(_scene: Scene) -> object:
    return None


@dataclass(frozen=True)
class OptionalPart:
    """An optional part of a test; a new one is one entry in ``PARTS``.

    Attributes:
        name: short name, and the row's.
        words: what it is.
        key: the scene's field that it stands in, or None.
        on: that field's value where the part is on, from the user's scene.
        off: that field's value where it is off.
        option: the keyword of the run that turns it on, or None.
        needs: a package that must be installed, or None.
        imports: modules, with all below them, that must not be imported while it is off.
        enters: functions as ``module:name``, by how they begin, that must not be called while it is off.
        in_all: whether ``all`` has it.
    """

    name: str
    words: str
    key: str | None = None
    on: Callable[[Scene], object] = _nothing
    off: Callable[[Scene], object] = _nothing
    option: Literal["with_bag", "with_estimate", "cross_check"] | None = None
    needs: str | None = None
    imports: tuple[str, ...] = ()
    enters: tuple[str, ...] = ()
    in_all: bool = True


def _denser_frames(scene: Scene) -> Sampling:
    rate = 2 * scene.sampling.poses_hz
    return scene.sampling.model_copy(update={"poses_hz": rate})


PARTS = (
    OptionalPart(
        "force_fields", "four force fields that hold the load",
        key="force_fields", on=lambda scene: scene.force_fields or ForceFields(),
        enters=("sim_core.force_fields:",),
    ),
    OptionalPart(
        "accelerometer", "readings of the sled's accelerometer",
        key="accelerometer", on=lambda scene: scene.accelerometer or Accelerometer(),
        enters=("sim_core.run:Peekable.__next__",),
    ),
    OptionalPart(
        "recording", "an MCAP bag of every message",
        option="with_bag", imports=("recordings", "msgs_adapters", "mcap", "zstandard"),
        enters=("recordings.", "msgs_adapters."),
    ),
    OptionalPart(
        "error_estimate", "the same test at twice the step, on another core",
        option="with_estimate", enters=("sim_core.companion:Companion.", "sim_core.companion:companion_scenes"),
    ),
    OptionalPart(
        "cross_check", "the same test on the other engine, on another core",
        option="cross_check", needs="mujoco", enters=("sim_core.companion:CrossCheck.",),
    ),
    OptionalPart(
        "dense_frames", "twice the pose frames, each with its monitors and its judging",
        key="sampling", on=_denser_frames, off=lambda scene: scene.sampling, in_all=False,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Variant:
    """One way of running the scene: a row of the table.

    Attributes:
        name: the row's name.
        words: what it is.
        scene: the resolved scene, parts put in and taken out.
        parts: names of the parts that are on.
        options: keywords of the run that are on.
        loop_only: whether it is the loop written by hand, with no product around it.
    """

    name: str
    words: str
    scene: Scene
    parts: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    loop_only: bool = False


@dataclass(frozen=True)
class Run:
    """What one process says about itself at its end.

    Attributes:
        loop_s: wall time of the test's loop, building the load included [s].
        simulated_s: simulated time; a part that changes the motion changes when the load rests [s].
        cpu_s: processor time of the process [s].
        cpu_beside_s: processor time of the processes that it started [s].
        peak_mb: its peak resident memory [MB].
        peak_beside_mb: that of the largest process that it started [MB]; 0 without any.
        threads: its threads at the end, as the kernel counts them.
        modules: names of the modules that it had imported.
        ended_by: the monitor that ended the test, or None.
        calls: calls of the product's own functions by ``module:name``; only of a traced run.
        loop_calls: number and time [s] of the calls that the test's loop makes itself; only of a traced run.
        process_s: wall time of the process from start to end, seen from outside [s].
    """

    loop_s: float
    simulated_s: float
    cpu_s: float
    cpu_beside_s: float
    peak_mb: float
    peak_beside_mb: float
    threads: int
    modules: tuple[str, ...]
    ended_by: str | None
    calls: Mapping[str, int] = field(default_factory=dict)
    loop_calls: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    process_s: float = 0.0


@dataclass(frozen=True)
class Graph:
    """A node graph: its nodes, and its topics but those that ROS gives every node."""

    nodes: tuple[str, ...]
    topics: tuple[str, ...]


def variants(scene: Scene) -> tuple[list[Variant], dict[str, str]]:
    """The rows that a scene can have, and why the others are left out, by name.

    Args:
        scene: the user's resolved scene.
    """
    bare = _changed(scene, {part.key: part.off(scene) for part in PARTS if part.key})
    rows = [
        Variant("bare_loop", "the loop written by hand: samples, physics, judge", bare, loop_only=True),
        Variant("bare", "a test without any optional part", bare),
    ]
    omitted: dict[str, str] = {}
    everything: list[OptionalPart] = []
    for part in PARTS:
        try:
            rows.append(_variant(part.name, part.words, scene, bare, [part]))
        except RefusedInput as refusal:
            omitted[part.name] = str(refusal)
            continue
        if part.in_all:
            everything.append(part)
    rows.append(
        _variant("all", "all of them: " + ", ".join(p.name for p in everything), scene, bare, everything)
    )
    return rows, omitted


def _chosen(scene: Scene, only: Collection[str]) -> tuple[list[Variant], dict[str, str]]:
    rows, omitted = variants(scene)
    names = [row.name for row in rows]
    for name in only:
        if name not in names:
            raise RefusedInput("--only", name, omitted.get(name, f"must be one of {', '.join(names)}"))
    return [row for row in rows if not only or row.name in {"bare_loop", "bare", *only}], omitted


def _variant(name: str, words: str, scene: Scene, bare: Scene, parts: list[OptionalPart]) -> Variant:
    for part in parts:
        if part.needs is not None and find_spec(part.needs) is None:
            raise RefusedInput(part.name, part.needs, "is not installed")
    return Variant(
        name,
        words,
        _changed(bare, {part.key: part.on(scene) for part in parts if part.key}),
        tuple(part.name for part in parts),
        tuple(part.option for part in parts if part.option is not None),
    )


def _changed(scene: Scene, values: Mapping[str, object]) -> Scene:
    """The scene with other parts; what does not fit together is refused."""
    return validate_scene(scene.model_copy(update=values).model_dump())


def measure_parts(
    scene: Scene,
    out: Path,
    *,
    repeats: int = 5,
    only: Collection[str] = (),
    on_progress: Callable[[int, int, object], None] | None = None,
) -> None:
    """Measures what each optional part costs and writes ``parts.json``, ``parts.csv`` and ``parts.md``.

    Every variant runs once to count calls, which also warms the caches, then ``repeats`` times in turn
    (a b c a b c ...), so that noise of the machine hits all alike. Of ``bare`` and ``all`` the node graph is
    started once as well.

    Args:
        scene: a resolved scene.
        out: folder for the tables, made where it is missing; tables of an earlier measurement are replaced.
        repeats: timed runs of every variant.
        only: names of rows to measure beside ``bare_loop`` and ``bare``; empty for all.
        on_progress: called with runs done, runs in all, and the name of the one that ended.

    Raises:
        RefusedInput: the load fails its integrity check, the folder cannot be made, there is no such row, or
            another twin runs in this ROS domain.
        NodeDied: a run, or a node of a graph, ended before its time.
    """
    import tempfile

    from ros_nodes.parts_page import table_of, write_tables
    from sim_core.integrity import require_integrity

    if repeats < 1:
        raise RefusedInput("repeats", repeats, "at least 1")
    require_integrity(scene)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedInput("--out", str(out), error.strerror or "cannot be made") from None
    rows, omitted = _chosen(scene, only)
    with_graph = [row for row in rows if row.name in ("bare", "all")]
    done, total = 0, len(with_graph) + (1 + repeats) * len(rows)

    def count(row: Variant) -> None:
        nonlocal done
        done += 1
        if on_progress is not None:
            on_progress(done, total, row.name)

    shown: dict[str, Graph] = {}
    traced: dict[str, Run] = {}
    timed: dict[str, list[Run]] = {row.name: [] for row in rows}
    with tempfile.TemporaryDirectory(prefix="parts-", dir=out) as scratch:
        for row in with_graph:
            shown[row.name] = graph_apart(row, Path(scratch) / f"graph_{row.name}")
            count(row)
        for row in rows:
            traced[row.name] = run_apart(row, Path(scratch) / row.name, traced=True)
            count(row)
        for _ in range(repeats):
            for row in rows:
                timed[row.name].append(run_apart(row, Path(scratch) / row.name))
                count(row)
    write_tables(table_of(scene, rows, timed, traced, shown, omitted), out)


def run_apart(variant: Variant, folder: Path, *, traced: bool = False) -> Run:
    """Runs a variant in a process of its own.

    Args:
        variant: what to run.
        folder: where the test writes its results.
        traced: count the calls of the product's functions; such a run is slower.

    Raises:
        NodeDied: the process gave no answer.
    """
    began = time.perf_counter()
    kind = "loop" if variant.loop_only else "test"
    answer = _answer_of(variant, {"kind": kind, "traced": traced, "out": str(folder)})
    process_s = time.perf_counter() - began
    return Run(**{**answer, "modules": tuple(answer["modules"]), "process_s": process_s})


def graph_apart(variant: Variant, folder: Path) -> Graph:
    """Starts a variant's node graph in a process of its own, runs the test, and tells what the graph showed.

    Raises:
        RefusedInput: another twin runs in the domain.
        NodeDied: a node ended before the test did, or there was no answer.
    """
    answer = _answer_of(variant, {"kind": "graph", "out": str(folder)})
    return Graph(tuple(answer["nodes"]), tuple(answer["topics"]))


def _answer_of(variant: Variant, job: Mapping[str, object]) -> dict[str, Any]:
    import subprocess

    from config.errors import NodeDied

    text = json.dumps({**job, "scene": variant.scene.to_json(), "options": variant.options})
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "ros_nodes.parts_cost"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Ctrl-C is for the command in front; it ends this run, which ends what runs beside it.
        start_new_session=True,
    )
    try:
        output, errors = process.communicate(text)
    except BaseException:
        process.terminate()
        process.wait()
        raise
    try:
        answer: dict[str, Any] = json.loads(output.splitlines()[-1])
    except (IndexError, json.JSONDecodeError):
        last = " ".join(errors.strip().splitlines()[-1:]) or "it said nothing"
        raise NodeDied(f"run '{variant.name}'", f"exit code {process.returncode}: {last}") from None
    if "refused" in answer:
        raise RefusedInput(*answer["refused"])
    return answer


def _run_loop(scene: Scene) -> tuple[float, float, str | None]:
    """The loop alone; its wall time [s], its simulated time [s] and the monitor that ended it."""
    from sim_core.judge import EumosJudge
    from sim_core.load_test import LoadTest
    from sim_core.sled import sled_samples

    ended_by = None
    began = time.perf_counter()
    test, judge = LoadTest(scene), EumosJudge(scene)
    try:
        for sample in sled_samples(scene):
            frame = test.take(sample)
            if frame is not None:
                judge.add(frame)
            if test.finished:
                break
    except EndedByMonitor as error:
        ended_by = str(error)
    finally:
        test.close()
    return time.perf_counter() - began, test.time_s, ended_by


def _run_test(scene: Scene, out: Path, options: Mapping[str, bool]) -> tuple[float, float, str | None]:
    """The test as the command runs it, report and page included."""
    from ros_nodes.one_test import make_folder, run_headless

    where = make_folder(scene, out, overwrite=True, with_bag=options["with_bag"])
    outcome = run_headless(
        scene, where, with_estimate=options["with_estimate"], cross_check=options["cross_check"]
    )
    ended_by = str(outcome.ended_by) if outcome.ended_by is not None else None
    numerics = outcome.report["numerics"]
    return numerics["wall_time_s"], numerics["simulated_s"], ended_by


def _measured(job: Mapping[str, Any]) -> Run:
    scene = scene_from_json(job["scene"])
    options = {name: name in job["options"] for name in ("with_bag", "with_estimate", "cross_check")}
    profile = None
    if job["traced"]:
        import cProfile

        profile = cProfile.Profile(builtins=False)
        profile.enable()
    if job["kind"] == "loop":
        loop_s, simulated_s, ended_by = _run_loop(scene)
    else:
        loop_s, simulated_s, ended_by = _run_test(scene, Path(job["out"]), options)
    modules = tuple(sorted(sys.modules))
    calls = _Calls(profile) if profile is not None else None
    import resource

    own, beside = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return Run(
        loop_s=loop_s,
        simulated_s=simulated_s,
        cpu_s=own.ru_utime + own.ru_stime,
        cpu_beside_s=beside.ru_utime + beside.ru_stime,
        peak_mb=_peak_kb() / 1024.0,
        peak_beside_mb=beside.ru_maxrss / 1024.0,
        threads=len(os.listdir("/proc/self/task")),  # noqa: PTH208 - no Path: it would count itself
        modules=modules,
        ended_by=ended_by,
        calls=calls.total if calls is not None else {},
        loop_calls=calls.of_loop if calls is not None else {},
    )


def _peak_kb() -> int:
    """Peak resident memory since the process' program began; ``ru_maxrss`` starts from that of its parent."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


class _Calls:
    """What a profile says about the product's own functions, by ``module:name``."""

    def __init__(self, profile: "cProfile.Profile") -> None:
        self._modules = {
            getattr(module, "__file__", None): name for name, module in list(sys.modules.items())
        }
        self.total: dict[str, int] = {}
        self.of_loop: dict[str, tuple[int, float]] = {}
        for entry in profile.getstats():
            name = self._name(entry.code)
            if name is not None:
                self.total[name] = entry.callcount
            if name in LOOPS:
                calls = ((self._name(call.code), call) for call in entry.calls or ())
                self.of_loop |= {name: (call.callcount, call.totaltime) for name, call in calls if name}

    def _name(self, code: Any) -> str | None:
        # Built-in functions have no code; the bodies of modules and classes, which an import runs, lack the flag.
        if isinstance(code, str) or not code.co_flags & CO_OPTIMIZED:
            return None
        module = self._modules.get(code.co_filename, "")
        return f"{module}:{code.co_qualname}" if module.partition(".")[0] in OUR_PACKAGES else None


def _graph(job: Mapping[str, Any]) -> Graph:
    """Runs the graph and looks at it once, from its first sign of progress on."""
    from ros_nodes.supervisor import Supervisor, configure_middleware

    seen: list[Graph] = []

    def look(_time_s: float, _states: dict[str, str]) -> None:
        if not seen:
            seen.append(_shown_graph())

    configure_middleware("localhost")
    bag = Path(job["out"]) / "bag" if "with_bag" in job["options"] else None
    Supervisor(scene_from_json(job["scene"]), "fast", bag, look).run()
    return seen[0]


def _shown_graph() -> Graph:
    import rclpy

    # A node of the supervisor's own context knows what that has discovered.
    node = rclpy.create_node("parts_look")
    nodes = {name for name, _ in node.get_node_names_and_namespaces() if name != "parts_look"}
    topics = {name for name, _ in node.get_topic_names_and_types()}
    node.destroy_node()
    given = {name for name in topics if name.endswith(("/rosout", "/parameter_events", "/transition_event"))}
    return Graph(tuple(sorted(nodes)), tuple(sorted(topics - given)))


def _interrupt(_number: int, _frame: object) -> None:
    raise Interrupted


def main() -> None:
    """Reads a job and prints what came of it, both as JSON."""
    signal.signal(signal.SIGTERM, _interrupt)
    job = json.loads(sys.stdin.read())
    try:
        answer = asdict(_graph(job) if job["kind"] == "graph" else _measured(job))
    except RefusedInput as refusal:
        answer = {"refused": [refusal.field, str(refusal.value), refusal.limit]}
    except Interrupted as interruption:
        sys.exit(interruption.exit_code)
    sys.stdout.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    main()
