"""Player and what stands beside it as processes, and what they make anew held against a recording."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

from config.errors import NodeDied, RefusedInput
from msgs_adapters.topics import CAMERA_PROGRESS, EUMOS_REPORT, Topic
from recordings.bag_reader import BagReader
from ros_nodes.node_process import SUPERVISED
from ros_nodes.supervisor import (
    DISCOVERY_S,
    NODE_END_TIMEOUT_S,
    POLL_S,
    SILENCE_LIMIT_S,
    START_TIMEOUT_S,
    NodeProcess,
    domain_of_its_own,
)

PLAYER = "player_node"
LAST_WORDS_S = 2.0
"""How long the player's account may be on its way after it ended."""

OnPlayed = Callable[[float, float, int], None]


@dataclass(frozen=True)
class Compared:
    """A topic that was made anew from a recording, beside the recorded one.

    Attributes:
        topic: relative name.
        count: messages made.
        recorded: messages that the bag has.
        different: how many of those made are not, byte for byte, the recorded one of the same number.
        first_different: number of the first such message, or None.
    """

    topic: str
    count: int
    recorded: int
    different: int
    first_different: int | None

    @property
    def is_equal(self) -> bool:
        """Whether both are the same messages to the last byte."""
        return self.count == self.recorded and not self.different


class Comparison:
    """Holds what arrives on a topic against what a bag has, message by message; memory doesn't grow."""

    def __init__(self, topic: Topic, reader: BagReader, recorded_name: str | None) -> None:
        self.topic = topic
        self.count = self.different = 0
        self._first: int | None = None
        self._recorded = reader.topics[recorded_name].message_count if recorded_name is not None else 0
        self._messages = reader.messages([recorded_name] if recorded_name is not None else [])

    def take(self, payload: bytes) -> None:
        """Takes the next message that was made anew."""
        expected = next(self._messages, None)
        if expected is not None and expected.payload != payload:
            self._first = self.count if self._first is None else self._first
            self.different += 1
        self.count += 1

    def result(self) -> Compared:
        """What came of it until now."""
        return Compared(self.topic.name, self.count, self._recorded, self.different, self._first)


@dataclass
class ReplayPlan:
    """Which nodes stand beside the player, and who reads what."""

    nodes: dict[str, dict[str, object]] = field(default_factory=dict)
    player_readers: dict[str, int] = field(default_factory=dict)
    answers: list[str] = field(default_factory=list)
    comparisons: list[Comparison] = field(default_factory=list)
    silence_limit_s: float = SILENCE_LIMIT_S


class ReplayGraph:
    """Player and what stands beside it as processes, from start to end."""

    def __init__(
        self,
        graph: ReplayPlan,
        player: Mapping[str, object],
        namespace: str,
        duration_s: float,
        on_progress: OnPlayed | None,
    ) -> None:
        self._graph, self._namespace, self._duration_s = graph, namespace, duration_s
        self._wanted = {**graph.nodes, PLAYER: dict(player)}
        self._on_progress = on_progress
        self._nodes: list[NodeProcess] = []
        self._summary: dict[str, Any] | None = None
        self._pictures_wanted: int | None = None
        self.report_json: str | None = None

    def run(self) -> dict[str, Any]:
        """Plays to the end; gives the player's account."""
        import rclpy

        with domain_of_its_own(self._namespace), tempfile.TemporaryDirectory(prefix="pallet-twin-") as folder:
            rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            try:
                self._connect()
                self._require_empty_domain()
                for name, parameters in self._wanted.items():
                    self._nodes.append(_start(name, parameters, self._namespace, Path(folder)))
                self._bring_up()
                self._follow()
                assert self._summary is not None
                return self._summary
            finally:
                self._end()
                self._node.destroy_node()
                rclpy.try_shutdown()

    def _connect(self) -> None:
        import rclpy
        from rclpy.experimental import EventsExecutor

        from msgs_adapters.topics import PLAYER_PROGRESS, message_class, to_rclpy

        self._node = rclpy.create_node("replay", namespace=self._namespace)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)

        def listen(topic: Topic, callback: Callable[[Any], None], *, raw: bool) -> None:
            kind, qos = message_class(topic.type_name), to_rclpy(topic.qos)
            self._node.create_subscription(kind, topic.name, callback, qos, raw=raw)

        listen(PLAYER_PROGRESS, self._take_played, raw=False)
        for comparison in self._graph.comparisons:
            listen(comparison.topic, self._taker(comparison), raw=True)
        if "camera_node" in self._graph.nodes:
            listen(CAMERA_PROGRESS, self._take_camera, raw=False)

    def _taker(self, comparison: Comparison) -> Callable[[bytes], None]:
        def take(payload: bytes) -> None:
            from rclpy.serialization import deserialize_message

            from msgs_adapters.topics import message_class

            self._heard = time.monotonic()
            comparison.take(payload)
            if comparison.topic is EUMOS_REPORT:
                self.report_json = deserialize_message(payload, message_class(EUMOS_REPORT.type_name)).data

        return take

    def _take_played(self, message: Any) -> None:
        from msgs_adapters.convert import progress_of

        self._heard = time.monotonic()
        progress = progress_of(message)
        if progress.finished:
            self._summary = json.loads(progress.values["summary"])
        if self._on_progress is not None:
            self._on_progress(float(progress.values["time_s"]), self._duration_s, progress.samples)

    def _take_camera(self, message: Any) -> None:
        from msgs_adapters.convert import progress_of

        self._heard = time.monotonic()
        progress = progress_of(message)
        if progress.finished:
            self._pictures_wanted = progress.frames

    def _require_empty_domain(self) -> None:
        until = time.monotonic() + DISCOVERY_S
        while time.monotonic() < until:
            self._executor.spin_once(timeout_sec=POLL_S)
        for name, space in self._node.get_node_names_and_namespaces():
            if space == self._namespace and name in self._wanted:
                limit = f"{name} runs there already; set another domain, or wait"
                raise RefusedInput("ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID", "0"), limit)

    def _bring_up(self) -> None:
        """The player comes last, and with it time."""
        from lifecycle_msgs.msg import Transition

        self._heard = time.monotonic()
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            for name in self._wanted:
                self._change_state(name, transition)

    def _change_state(self, name: str, transition: int) -> None:
        from lifecycle_msgs.srv import ChangeState

        service = f"{self._namespace.rstrip('/')}/{name}/change_state"
        client = self._node.create_client(ChangeState, service)
        request = ChangeState.Request()
        request.transition.id = transition
        deadline = time.monotonic() + START_TIMEOUT_S
        is_done = False
        while not is_done:
            while not client.service_is_ready():
                self._spin(name, deadline)
            future = client.call_async(request)
            while not future.done():
                self._spin(name, deadline)
            is_done = future.result().success
            if not is_done:
                self._spin(name, deadline)
        self._node.destroy_client(client)

    def _spin(self, name: str, deadline: float) -> None:
        self._executor.spin_once(timeout_sec=POLL_S)
        self._watch()
        if time.monotonic() > deadline:
            node = next(node for node in self._nodes if node.name == name)
            raise NodeDied(name, f"it did not start within {START_TIMEOUT_S:.0f} s: {node.last_words()}")

    def _follow(self) -> None:
        """Spins until the player ended and everything that is made anew is there."""
        while not self._is_over():
            self._executor.spin_once(timeout_sec=POLL_S)
            self._watch()
            if time.monotonic() - self._heard > self._graph.silence_limit_s:
                silent = next(iter(self._graph.nodes), PLAYER)
                raise NodeDied(silent, f"nothing came from it for {self._graph.silence_limit_s:.0f} s")

    def _is_over(self) -> bool:
        if self._summary is None:
            return False
        drawn = [c for c in self._graph.comparisons if c.topic.name.startswith("camera/")]
        return ("validator_node" not in self._graph.nodes or self.report_json is not None) and (
            "camera_node" not in self._graph.nodes
            or all(comparison.count == self._pictures_wanted for comparison in drawn)
        )

    def _watch(self) -> None:
        """Raises when a node is gone that should not be."""
        for node in self._nodes:
            code = node.process.poll()
            if code is None:
                continue
            if node.name == PLAYER and code == 0:
                until = time.monotonic() + LAST_WORDS_S
                while self._summary is None and time.monotonic() < until:
                    self._executor.spin_once(timeout_sec=POLL_S)
                if self._summary is not None:
                    continue
            if code == RefusedInput.exit_code:
                raise _Refused(node.last_words().split(" | ")[-1])
            raise NodeDied(node.name, f"{node.ending()}: {node.last_words()}")

    def _end(self) -> None:
        """Ends what still runs, the player first: it ends by itself once its readers have everything."""
        for node in reversed(self._nodes):
            if node.process.poll() is None and not (node.name == PLAYER and self._summary is not None):
                node.process.terminate()
        for node in reversed(self._nodes):
            try:
                node.process.wait(NODE_END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                node.process.kill()
                node.process.wait()


class _Refused(RefusedInput):
    """A node refused its input; its own line says why."""

    def __init__(self, line: str) -> None:
        Exception.__init__(self, line)


def _start(name: str, parameters: Mapping[str, object], namespace: str, folder: Path) -> NodeProcess:
    defaults = str(files("config").joinpath("nodes.yaml"))
    arguments = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", defaults]
    for key, value in parameters.items():
        arguments += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
    log = folder / f"{name}.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", f"ros_nodes.{name}", *arguments],
            stdin=subprocess.DEVNULL,
            env={**os.environ, SUPERVISED: "1"},
            stdout=stream,
            stderr=subprocess.STDOUT,
            # Ctrl-C reaches this process alone, which then ends the nodes in order.
            start_new_session=True,
        )
    return NodeProcess(name, process, log)
