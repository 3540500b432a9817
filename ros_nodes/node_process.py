"""What every node process shares: start, spin, clean end; matched peers; publishing ready-made bytes."""

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from types import FrameType
from typing import Any, Protocol

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos_overriding_options import QoSOverridingOptions

from config.errors import PalletTwinError
from msgs_adapters.publications import Publication
from msgs_adapters.topics import Topic, message_class, to_rclpy
from ros_nodes.readers import readers_wanted

SPIN_PERIOD_S = 0.05
SUPERVISED = "PALLET_TWIN_SUPERVISED"
PR_SET_PDEATHSIG = 1
MATCH_TIMEOUT_S = 15.0
ACKNOWLEDGE_TIMEOUT_S = 5.0


class TwinNode(LifecycleNode):  # type: ignore[misc]
    """A lifecycle node that sends ready-made bytes and knows how many readers it must have first.

    Args:
        name: the node's name.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._publishers_by_topic: dict[Topic, Any] = {}
        self.published: dict[str, int] = {}
        self.failure: str | None = None
        self.error: PalletTwinError | None = None
        self.done = False
        self._awaited: dict[str, int] = {}

    def await_readers(self) -> None:
        """Declares the parameter ``readers``: the node becomes active once its topics have so many matched readers.

        Raises:
            RefusedInput: the parameter has another form.
        """
        text = self.declare("readers", "", "matched readers to wait for, topic=count, comma-separated")
        self._awaited = readers_wanted(text)

    def declare(self, name: str, default: Any, text: str, **limits: Any) -> Any:
        """Declares a read-only parameter with its description and range, and returns its value."""
        descriptor = ParameterDescriptor(description=text, read_only=True)
        if limits:
            if isinstance(default, int):
                descriptor.integer_range = [IntegerRange(step=0, **limits)]
            else:
                descriptor.floating_point_range = [FloatingPointRange(step=0.0, **limits)]
        return self.declare_parameter(name, default, descriptor).value

    def open_topic(self, topic: Topic) -> None:
        """Makes a publisher whose quality of service a user can override."""
        self._publishers_by_topic[topic] = self.create_publisher(
            message_class(topic.type_name),
            topic.name,
            to_rclpy(topic.qos),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self.published[topic.name] = 0

    def listen(self, topic: Topic, callback: Callable[..., None], *, raw: bool = False) -> None:
        """Makes a subscription whose quality of service a user can override."""
        self.create_subscription(
            message_class(topic.type_name),
            topic.name,
            callback,
            to_rclpy(topic.qos),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            raw=raw,
        )

    def send(self, publication: Publication) -> None:
        """Publishes one message as the bytes that it already is."""
        self._publishers_by_topic[publication.topic].publish(publication.payload)
        self.published[publication.topic.name] += 1

    def has_readers(self, topic: Topic) -> bool:
        """Whether anybody subscribed to a topic."""
        return bool(self._publishers_by_topic[topic].get_subscription_count())

    def wait_for_readers(self, wanted: Mapping[str, int]) -> str | None:
        """Waits until each topic has so many matched readers; says which are missing, or None.

        Matched counts, not time: what is sent before a reader is matched never reaches it.

        Args:
            wanted: number of readers by relative topic name.
        """
        publishers = {topic.name: publisher for topic, publisher in self._publishers_by_topic.items()}
        deadline = time.monotonic() + MATCH_TIMEOUT_S
        while True:
            missing = [
                f"{name} has {publishers[name].get_subscription_count()} of {count}"
                for name, count in wanted.items()
                if name in publishers and publishers[name].get_subscription_count() < count
            ]
            if not missing:
                return None
            if time.monotonic() > deadline:
                return ", ".join(missing)
            time.sleep(0.005)

    def wait_for_acknowledgement(self) -> None:
        """Waits until every matched reliable reader has everything."""
        from rclpy.duration import Duration

        for publisher in self._publishers_by_topic.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))

    def set_up(self) -> bool:
        """Makes the node's entities; False while what it needs is not there yet. Called on configure."""
        return True

    def on_configure(self, state: LifecycleState) -> Any:
        """Sets the node up; an error of the family ends the process with its line and its code."""
        # rclpy would swallow what a transition raises.
        try:
            if not self.set_up():
                return FAILURE
        except PalletTwinError as error:
            self.error, self.done = error, True
            return FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> Any:
        """Waits for the readers that were asked for."""
        missing = self.wait_for_readers(self._awaited)
        if missing is not None:
            self.get_logger().error(f"no reader for {missing}")
            return FAILURE
        return super().on_activate(state)

    def on_stop(self) -> bool:
        """Called again and again after a signal asked the process to end; True when it may."""
        return True

    def on_end(self) -> None:
        """Called once before the node is destroyed."""

    def fail(self, reason: str) -> None:
        """Ends the process with exit code 3 and a last line."""
        self.failure = reason
        self.done = True


class NodeFactory(Protocol):
    """Something that makes a node once ROS is initialised."""

    def __call__(self) -> TwinNode: ...


def _end_with_parent() -> None:
    """Has the kernel send SIGTERM when the supervisor is gone, however it went; a node started by hand stays."""
    if os.environ.get(SUPERVISED):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))


def run_node(factory: NodeFactory, args: list[str] | None) -> None:
    """Runs one node as a process: SIGINT and SIGTERM end it properly, errors give one line.

    Exits with 0, with 2 for refused input, with 3 when the node gave up.
    """
    stopping = False

    def ask_to_stop(_number: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    # The node ends itself, when what it holds is safe; rclpy's own handlers would end its context first.
    _end_with_parent()
    rclpy.init(args=args, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    signal.signal(signal.SIGINT, ask_to_stop)
    signal.signal(signal.SIGTERM, ask_to_stop)
    code, node = 0, None
    try:
        node = factory()
        executor = EventsExecutor()
        executor.add_node(node)
        # EventsExecutor.spin() delivers nothing in rclpy 7.1 and ignores signals: spin_once in a loop.
        while not node.done and not (stopping and node.on_stop()):
            executor.spin_once(timeout_sec=SPIN_PERIOD_S)
        if node.error is not None:
            raise node.error
    except PalletTwinError as error:
        print(f"{node.get_name() if node else 'node'}: {error}", file=sys.stderr, flush=True)
        code = error.exit_code
    finally:
        if node is not None:
            node.on_end()
            if node.failure is not None:
                print(f"{node.get_name()}: {node.failure}", file=sys.stderr, flush=True)
                code = 3
            node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(code)


SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE

__all__ = ["FAILURE", "SUCCESS", "LifecycleState", "TwinNode", "run_node"]
