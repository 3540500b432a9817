"""Starts the node graph that a scene needs, watches it, and ends it so that nothing recorded is lost."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from config.errors import EndedByMonitor, NodeDied, PalletTwinError, RefusedInput
from config.scene import Scene
from recordings.test_bag import recorded_topics
from ros_nodes.node_process import SUPERVISED
from ros_nodes.readers import readers_text
from ros_nodes.shared_memory import remove_orphans
from sim_core.run import PhysicsSummary

NAMESPACE = "/twin"
START_TIMEOUT_S = 30.0
RECORDER_END_TIMEOUT_S = 15.0
NODE_END_TIMEOUT_S = 5.0
SILENCE_LIMIT_S = 60.0
# The first test of a wrapped load compiles the film's kernels: about 20 s on two cores.
SILENCE_LIMIT_WRAPPED_S = 240.0
POLL_S = 0.02
TWIN_NODES = {
    "supervisor",
    "sled_node",
    "bench_node",
    "residual_node",
    "physics_node",
    "validator_node",
    "recorder_node",
    "camera_node",
    "vision_node",
    "classifier_node",
}
DISCOVERY_S = 0.8
RESIDUAL_WAIT_S = 1.0


@dataclass
class NodeProcess:
    """One node of the graph as a process.

    Attributes:
        name: the executable's name.
        process: the running process.
        log: file that takes its output.
    """

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def last_words(self) -> str:
        """The last lines that it printed."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return " | ".join(lines[-3:]) or "it printed nothing"

    def ending(self) -> str:
        """How it ended."""
        code = self.process.returncode
        return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


@dataclass(frozen=True)
class GraphResult:
    """What a graph leaves behind.

    Attributes:
        judgement_json: the report that the validator published.
        physics: the physics' own account.
        ended_by: the monitor that ended the test, or None.
        wall_s: wall time from the first sample to the report [s].
        notes: what nodes said about falling behind or missing messages, or an empty text.
        measured_json: what the pictures say, where the scene has them measured.
        residual_json: what the machine's measured displacement differs by, where it drives and something measures.
        classified_json: what a classifier guesses from the pictures, where one was asked for.
    """

    judgement_json: str
    physics: PhysicsSummary
    ended_by: EndedByMonitor | None
    wall_s: float
    notes: str
    measured_json: str | None = None
    residual_json: str | None = None
    classified_json: str | None = None


def configure_middleware(discovery: Literal["localhost", "subnet"]) -> None:
    """Sets discovery range and transport profile in this process' environment, where the user did not.

    Must run before the first ``rclpy.init``.
    """
    if discovery == "localhost":
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    profile = "fastdds.xml" if discovery == "localhost" else "fastdds_subnet.xml"
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(files("config").joinpath(profile)))


@dataclass
class Supervisor:
    """The graph of one test.

    Args:
        scene: a resolved scene that passed its integrity check.
        pace: ``fast`` or ``real``.
        bag: directory to record into, or None.
        on_progress: called with simulated time [s] and the names and states of the rules.
        guests: readers from outside that each stream must have before the first sample.
        pictures: bag whose pictures the camera shows, or None to draw them.
        with_view: whether a live view is served.
        bench: whether the machine's accelerometer drives it.
        split: size [MB] and simulated time [s] after which the bag begins a new file; 0: never.
        classify: folder of a model that guesses from the pictures while it runs, or None.
    """

    scene: Scene
    pace: Literal["fast", "real"]
    bag: Path | None
    on_progress: Callable[[float, dict[str, str]], None] | None = None
    guests: int = 0
    pictures: Path | None = None
    with_view: bool = False
    split: tuple[int, float] = (0, 0.0)
    bench: bool = False
    classify: Path | None = None
    _nodes: list[NodeProcess] = field(default_factory=list)
    _states: dict[str, str] = field(default_factory=dict)
    _report: str | None = None
    _final: Any = None
    _has_pictures: bool = False
    _measured: str | None = None
    _residual: str | None = None
    _classified: str | None = None
    _notes: str = ""

    @property
    def _measures(self) -> bool:
        return self.scene.camera is not None and self.scene.camera.measure

    def run(self) -> GraphResult:
        """Runs the test to its end.

        Raises:
            NodeDied: a node ended before the test did; the bag until then is whole.
            Interrupted: the user stopped it; the bag until then is whole.
        """
        import rclpy

        with domain_of_its_own(), tempfile.TemporaryDirectory(prefix="pallet-twin-") as folder:
            rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            try:
                self._connect()
                self._require_empty_domain()
                self._start(Path(folder))
                self._bring_up()
                self._follow()
                self._wait_for_the_machine()
                wall_s = time.monotonic() - self._began
                self._end(in_order=True)
                return self._result(wall_s)
            finally:
                was_cut_short = bool(self._nodes)
                self._end(in_order=False)
                self._node.destroy_node()
                rclpy.try_shutdown()
                if was_cut_short:
                    remove_orphans(but_mine=True)

    def _connect(self) -> None:
        """An own node: it listens to progress, status and report, and calls the lifecycle services."""
        import rclpy
        from rclpy.experimental import EventsExecutor

        from msgs_adapters.topics import (
            CAMERA_PROGRESS,
            CLASSIFIER_REPORT,
            EUMOS_REPORT,
            EUMOS_STATUS,
            PHYSICS_PROGRESS,
            RESIDUAL_REPORT,
            VISION_REPORT,
            message_class,
            to_rclpy,
        )

        self._node = rclpy.create_node("supervisor", namespace=NAMESPACE)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        for topic, callback in (
            (PHYSICS_PROGRESS, self._take_progress),
            (EUMOS_STATUS, self._take_status),
            (EUMOS_REPORT, self._take_report),
            *([(CAMERA_PROGRESS, self._take_camera)] if self.scene.camera is not None else []),
            *([(VISION_REPORT, self._take_measured)] if self._measures else []),
            *([(RESIDUAL_REPORT, self._take_residual)] if self.bench else []),
            *([(CLASSIFIER_REPORT, self._take_classified)] if self.classify is not None else []),
        ):
            self._node.create_subscription(
                message_class(topic.type_name), topic.name, callback, to_rclpy(topic.qos)
            )

    def _require_empty_domain(self) -> None:
        """Refuses a domain in which another twin runs: the two would drive each other's nodes."""
        until = time.monotonic() + DISCOVERY_S
        while time.monotonic() < until:
            self._executor.spin_once(timeout_sec=POLL_S)
        nodes = self._node.get_node_names_and_namespaces()
        found = [name for name, space in nodes if space == NAMESPACE and name in TWIN_NODES]
        if len(found) > 1:
            raise _another_twin()

    def _start(self, folder: Path) -> None:
        scene_file = folder / "scene.json"
        scene_file.write_text(self.scene.to_json(), encoding="utf-8")
        defaults = str(files("config").joinpath("nodes.yaml"))
        for name, parameters in self.nodes_needed(scene_file):
            log = folder / f"{name}.log"
            arguments = ["--ros-args", "-r", f"__ns:={NAMESPACE}", "--params-file", defaults]
            for key, value in parameters.items():
                arguments += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
            with log.open("wb") as stream:
                process = subprocess.Popen(
                    [sys.executable, "-P", "-m", f"ros_nodes.{name}", *arguments],
                    stdin=subprocess.DEVNULL,
                    env={**os.environ, SUPERVISED: "1"},
                    stdout=stream,
                    stderr=subprocess.STDOUT,
                    # Ctrl-C reaches the supervisor alone, which then ends the nodes in order.
                    start_new_session=True,
                )
            self._nodes.append(NodeProcess(name, process, log))

    def nodes_needed(self, scene_file: Path) -> Iterator[tuple[str, dict[str, object]]]:
        """The nodes that the scene needs, in the order of their start, with their parameters.

        Each publisher waits for as many readers as the graph has for its topic.
        """
        recorded = [topic.name for topic in recorded_topics(self.scene)] if self.bag is not None else []
        recorded += (
            ["residual/displacement", "residual/report"] if self.bench and self.bag is not None else []
        )
        guesses = ("classifier/failure_probability", "classifier/report") if self.classify is not None else ()
        recorded += guesses if self.bag is not None else ()
        taken_down = dict.fromkeys(recorded, 1)
        if self.with_view:
            from ros_nodes.viewer_node import VIEWED

            taken_down |= {topic.name: taken_down.get(topic.name, 0) + 1 for topic in VIEWED}
            yield "viewer_node", {}
        cameras, visions = int(self.scene.camera is not None), int(self._measures)
        residuals, classifiers = int(self.bench), int(self.classify is not None)
        film = {"wrap/strain": 1 + cameras + self.guests} if self.scene.film is not None else {}
        if self.bag is not None:
            size_mb, after_s = self.split
            yield (
                "recorder_node",
                {
                    "bag": str(self.bag.resolve()),
                    "topics": ",".join(recorded),
                    "split_mb": size_mb,
                    "split_s": float(after_s),
                },
            )
        yield "validator_node", {"readers": readers_text(_sum(taken_down, {"eumos/status": 1, "eumos/report": 1},
                                                              only=("eumos/status", "eumos/report")))}  # fmt: skip
        physics = _sum(
            taken_down,
            {
                "packages/poses": 1 + cameras + residuals + self.guests,
                "physics/progress": 3 + cameras + residuals,
                "scene": 2 + cameras + visions + residuals,
                **film,
            },
            only=("packages/poses", "physics/progress", "scene", "robot_description", *film),
        )
        if visions:
            said = _sum(taken_down, {"vision/report": 1}, only=("vision/displacement", "vision/report"))
            yield "vision_node", {"readers": readers_text(said)}
        if self.classify is not None:
            said = _sum(taken_down, {"classifier/report": 1}, only=guesses)
            model = str(self.classify.resolve())
            yield "classifier_node", {"model": model, "readers": readers_text(said)}
        if cameras:
            names = ("camera/camera_info", "camera/image_raw", "camera/image_raw/compressed")
            seen = _sum(
                taken_down,
                {
                    "camera/camera_info": visions + self.guests,
                    "camera/image_raw": visions + self.guests,
                    "camera/image_raw/compressed": classifiers + self.guests,
                    "camera/progress": 1 + visions + classifiers,
                },
                only=(*names, "camera/progress"),
            )
            pictures = str(self.pictures.resolve()) if self.pictures is not None else ""
            yield (
                "camera_node",
                {"readers": readers_text(seen), "pictures": pictures, "pace": self.pace},
            )
        yield "physics_node", {"scene_file": str(scene_file), "readers": readers_text(physics)}
        sled = _sum(
            taken_down,
            {
                "sled/acceleration": 1 + self.guests,
                "sled/odometry": cameras + self.guests,
                "sled/accelerometer": self.guests,
            },
            only=("/clock", "sled/acceleration", "sled/odometry", "sled/accelerometer"),
        )
        if self.bench:
            said = _sum(taken_down, {"residual/report": 1}, only=("residual/displacement", "residual/report"))
            yield "residual_node", {"readers": readers_text(said)}
            yield "bench_node", {"readers": readers_text(sled)}
        else:
            yield "sled_node", {"pace": self.pace, "readers": readers_text(sled)}

    def _bring_up(self) -> None:
        """Configures and activates every node; the sled comes last, and with it time."""
        from lifecycle_msgs.msg import Transition

        clock = "bench_node" if self.bench else "sled_node"
        configured = [node.name for node in self._nodes if node.name != clock]
        for name in configured:
            self._change_state(name, Transition.TRANSITION_CONFIGURE)
        for name in configured:
            self._change_state(name, Transition.TRANSITION_ACTIVATE)
        self._change_state(clock, Transition.TRANSITION_CONFIGURE)
        self._began = time.monotonic()
        self._change_state(clock, Transition.TRANSITION_ACTIVATE)

    def _change_state(self, name: str, transition: int) -> None:
        from lifecycle_msgs.srv import ChangeState

        client = self._node.create_client(ChangeState, f"{NAMESPACE}/{name}/change_state")
        request = ChangeState.Request()
        request.transition.id = transition
        deadline = time.monotonic() + START_TIMEOUT_S
        while True:
            while not client.service_is_ready():
                self._spin_until(deadline, name)
            future = client.call_async(request)
            while not future.done():
                self._spin_until(deadline, name)
            if future.result().success:
                break
            # A node refuses while what it waits for is on its way: the sled its scene.
            pause = time.monotonic() + 0.05
            while time.monotonic() < pause:
                self._spin_until(deadline, name)
        self._node.destroy_client(client)

    def _spin_until(self, deadline: float, name: str) -> None:
        self._executor.spin_once(timeout_sec=POLL_S)
        self._watch()
        if time.monotonic() > deadline:
            node = next(node for node in self._nodes if node.name == name)
            raise NodeDied(name, f"it did not start within {START_TIMEOUT_S:.0f} s: {node.last_words()}")

    def _follow(self) -> None:
        """Spins until the report is there."""
        limit_s = SILENCE_LIMIT_S if self.scene.film is None else SILENCE_LIMIT_WRAPPED_S
        self._heard = time.monotonic()
        while not self._is_over():
            self._executor.spin_once(timeout_sec=POLL_S)
            self._watch()
            if time.monotonic() - self._heard > limit_s:
                silent = "physics_node"
                if self._report and self._final:
                    silent = "vision_node" if self._has_pictures else "camera_node"
                raise NodeDied(silent, f"no progress for {limit_s:.0f} s")

    def _wait_for_the_machine(self) -> None:
        """What is measured last comes after the twin's end; a machine that measures nothing says nothing."""
        until = time.monotonic() + RESIDUAL_WAIT_S
        while self.bench and time.monotonic() < until:
            self._executor.spin_once(timeout_sec=POLL_S)

    def _is_over(self) -> bool:
        """Whether the report is there, and every picture taken and measured that the scene asks for."""
        return (
            self._report is not None
            and self._final is not None
            and (self._has_pictures or self.scene.camera is None)
            and (self._measured is not None or not self._measures)
            and (self._classified is not None or self.classify is None)
        )

    def _watch(self) -> None:
        """Raises when a node is gone."""
        for node in self._nodes:
            if node.process.poll() is None:
                continue
            if node.process.returncode == RefusedInput.exit_code:
                raise _Refused(node.last_words())
            raise NodeDied(node.name, f"{node.ending()}: {node.last_words()}")

    def _end(self, *, in_order: bool) -> None:
        """Ends every node that still runs.

        Args:
            in_order: everything has been sent. The senders end first, each once every reader has acknowledged
                what it sent (a message lost on its way is sent again only after some time), the recorder last.
                Otherwise the others are killed at once, as they hold nothing, and the recorder saves the rest.
        """
        recorder = next((node for node in self._nodes if node.name == "recorder_node"), None)
        others = [node for node in self._nodes if node is not recorder]
        for node in others:
            if in_order:
                node.process.terminate()
            else:
                node.process.kill()
        for node in others:
            self._stop(node, NODE_END_TIMEOUT_S)
        if recorder is not None:
            self._stop(recorder, RECORDER_END_TIMEOUT_S)
        self._notes = (
            " | ".join(
                line.split("]: ")[-1]
                for node in self._nodes
                if node.log.exists()
                for line in node.log.read_text(encoding="utf-8", errors="replace").splitlines()
                if "fell behind" in line or "never arrived" in line
            )
            or self._notes
        )
        self._nodes = []
        if recorder is not None and self.bag is not None:
            self._make_whole(self.bag)

    @staticmethod
    def _stop(node: NodeProcess, timeout_s: float) -> None:
        if node.process.poll() is None:
            node.process.terminate()
        try:
            node.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            node.process.kill()
            node.process.wait()

    @staticmethod
    def _make_whole(bag: Path) -> None:
        """A recorder that was killed leaves a file without its end."""
        if any(bag.glob("*.part")):
            from recordings.rescue import rescue_bag

            rescue_bag(bag)

    def _take_progress(self, message: Any) -> None:
        from msgs_adapters.convert import progress_of

        self._heard = time.monotonic()
        progress = progress_of(message)
        if progress.finished:
            self._final = progress
        if self.on_progress is not None:
            self.on_progress(float(progress.values.get("time_s", "0")), self._states)

    def _take_camera(self, message: Any) -> None:
        from msgs_adapters.convert import progress_of

        self._heard = time.monotonic()
        progress = progress_of(message)
        self._has_pictures = progress.finished
        if self.on_progress is not None and self._final is not None:
            words = f"{progress.values['pictures']} of {progress.values['of']}"
            self.on_progress(
                float(self._final.values.get("time_s", "0")), {**self._states, "pictures": words}
            )

    def _take_measured(self, message: Any) -> None:
        self._measured = message.data

    def _take_classified(self, message: Any) -> None:
        self._classified = message.data

    def _take_residual(self, message: Any) -> None:
        self._residual = message.data

    def _take_status(self, message: Any) -> None:
        from msgs_adapters.convert import rule_states

        self._states = {rule.rule: rule.state for rule in rule_states(message)}

    def _take_report(self, message: Any) -> None:
        self._report = message.data

    def _result(self, wall_s: float) -> GraphResult:
        assert self._report is not None and self._final is not None
        values = self._final.values
        ended_by = None
        if self._final.error is not None:
            ended_by = EndedByMonitor(values["monitor"], values["reason"], float(values["time_s"]))
        return GraphResult(
            judgement_json=self._report,
            physics=PhysicsSummary(**json.loads(values["summary"])),
            ended_by=ended_by,
            wall_s=wall_s,
            notes=self._notes,
            measured_json=self._measured,
            residual_json=self._residual,
            classified_json=self._classified,
        )


class _Refused(PalletTwinError):
    """A node refused its input; its own line says why."""

    exit_code = 2


def _sum(first: dict[str, int], second: dict[str, int], *, only: tuple[str, ...]) -> dict[str, int]:
    return {name: count for name in only if (count := first.get(name, 0) + second.get(name, 0))}


@contextmanager
def domain_of_its_own(namespace: str = NAMESPACE) -> Iterator[None]:
    """Keeps other supervisors of this host out of the domain's namespace until this one has ended, however it ends.

    Discovery alone finds another twin late on a busy machine, and then both have called the other's nodes.

    Raises:
        RefusedInput: another one has it.
    """
    path = Path(tempfile.gettempdir()) / f"pallet-twin-domain-{quote(_domain() + namespace, safe='')}.lock"
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except PermissionError:
        # Another user's: discovery has to do.
        yield
        return
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _another_twin() from None
        yield
    finally:
        os.close(file)


def _domain() -> str:
    return os.environ.get("ROS_DOMAIN_ID", "0")


def _another_twin() -> RefusedInput:
    return RefusedInput("ROS_DOMAIN_ID", _domain(), "another twin runs there; set another domain, or wait")
