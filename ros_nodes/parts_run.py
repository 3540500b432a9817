"""One variant in a process of its own, which tells what it took: time, memory, modules, calls, nodes and topics.

Runs as ``python -m ros_nodes.parts_run`` with a job as JSON on standard input. That process measures what it
imported, so this module itself imports nothing that a test would not.
"""

import json
import os
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from config.errors import EndedByMonitor, Interrupted, RefusedInput
from config.scene import Scene
from config.scene_file import scene_from_json
from ros_nodes.parts import Option, Variant

if TYPE_CHECKING:
    import cProfile

OUR_PACKAGES = ("config", "sim_core", "msgs_adapters", "recordings", "classifier", "ros_nodes", "__main__")
LOOPS = ("sim_core.run:run_test", "__main__:_run_loop")
CO_OPTIMIZED = 0x1


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
        [sys.executable, "-P", "-m", "ros_nodes.parts_run"],
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
    """The test as the command runs it, report included."""
    from ros_nodes.one_test import make_folder, run_headless

    where = make_folder(
        scene, out, overwrite=True, with_bag=options["with_bag"], with_page=options["with_page"]
    )
    outcome = run_headless(
        scene, where, with_estimate=options["with_estimate"], cross_check=options["cross_check"]
    )
    ended_by = str(outcome.ended_by) if outcome.ended_by is not None else None
    numerics = outcome.report["numerics"]
    return numerics["wall_time_s"], numerics["simulated_s"], ended_by


def _measured(job: Mapping[str, Any]) -> Run:
    scene = scene_from_json(job["scene"])
    options = {name: name in job["options"] for name in get_args(Option)}
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
