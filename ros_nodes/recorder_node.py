"""Writes every topic of the graph, unparsed, into a bag."""

import time
from pathlib import Path
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.validate_topic_name import validate_topic_name

from config.errors import RefusedInput
from msgs_adapters.topics import ALL_TOPICS, STREAM, TF, QosSpec, Topic
from recordings.graph_recorder import GraphRecorder
from recordings.schemas import message_definition
from ros_nodes.node_process import TwinNode, run_node

QUIET_FOR_S = 0.3
DRAIN_LIMIT_S = 10.0


class RecorderNode(TwinNode):
    """Subscribes raw to the topics named in ``topics`` and records them into ``bag``.

    The twin's own topics are subscribed to before anybody publishes them; another one is recorded as it is
    published, so it must be when the node is configured.

    When it is asked to end it first takes in what is still on its way: it ends once nothing has arrived
    for a while, and finishes the bag. Holes in the stamps of regular topics are counted and written into
    the bag. When the disk is too slow, or time runs back because a node started anew, it says so in one line.
    """

    def __init__(self) -> None:
        super().__init__("recorder_node")
        self._directory = self.declare("bag", "", "directory of the bag; must not exist, or be empty")
        self._topic_names = self.declare(
            "topics", "", "topic names, comma-separated; empty for all of the twin"
        )
        self._split_mb = self.declare(
            "split_mb", 0, "a new file after so many MB; 0 for none", from_value=0, to_value=10**6
        )
        self._split_s = self.declare(
            "split_s",
            0.0,
            "a new file after so much simulated time [s]; 0 for none",
            from_value=0.0,
            to_value=1e6,
        )
        self._recorder: GraphRecorder | None = None
        self._told = 0
        self._asked_to_end: float | None = None

    def set_up(self) -> bool:
        """Opens the bag and subscribes."""
        if not self._directory:
            raise RefusedInput("bag", "empty", "name a directory")
        known = {topic.name: topic for topic in ALL_TOPICS if topic is not TF}
        names = self._topic_names.split(",") if self._topic_names else list(known)
        topics = [topic for name in names if (topic := known.get(name) or self._published(name)) is not None]
        if len(topics) < len(names):
            return False
        self._recorder = GraphRecorder(
            Path(self._directory),
            topics,
            namespace=self.get_namespace(),
            split_bytes=self._split_mb * 10**6 or None,
            split_s=self._split_s or None,
        )
        for topic in topics:
            self.listen(topic, self._taker(topic), raw=True)
        return True

    def _published(self, name: str) -> Topic | None:
        """A topic that is none of the twin's, with type and QoS as it is published; None while it is not.

        Raises:
            RefusedInput: it can be no topic's name, or its type is not installed.
        """
        try:
            validate_topic_name(name)
        except InvalidTopicNameException as error:
            raise RefusedInput("topics", name, str(error).splitlines()[0]) from None
        absolute = self.resolve_topic_name(name)
        types = dict(self.get_topic_names_and_types()).get(absolute)
        offers = [info.qos_profile for info in self.get_publishers_info_by_topic(absolute)]
        if not types or not offers:
            self.get_logger().warning(f"nobody publishes {absolute} yet")
            return None
        message_definition(types[0])
        # A reliable subscription never matches a best-effort publisher, a latched one no volatile one.
        is_lossy = any(offer.reliability == ReliabilityPolicy.BEST_EFFORT for offer in offers)
        is_latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
        qos = QosSpec(
            "best_effort" if is_lossy else "reliable",
            "transient_local" if is_latched else "volatile",
            STREAM.depth,
        )
        return Topic(name, types[0], qos)

    def on_stop(self) -> bool:
        """True once nothing has arrived for a while."""
        if self._recorder is None:
            return True
        now = time.monotonic()
        self._asked_to_end = self._asked_to_end or now
        quiet_since = max(self._recorder.last_arrival, self._asked_to_end)
        return now - quiet_since > QUIET_FOR_S or now - self._asked_to_end > DRAIN_LIMIT_S

    def on_end(self) -> None:
        """Finishes the bag."""
        if self._recorder is None:
            return
        self._recorder.close()
        self._tell()
        for name, missing in self._recorder.gaps.items():
            self.get_logger().error(f"{missing} messages of {name} never arrived")
        if self._recorder.error is not None:
            self.fail(self._recorder.error)

    def _tell(self) -> None:
        assert self._recorder is not None
        for note in self._recorder.notes[self._told :]:
            self.get_logger().warning(note)
            self._told += 1

    def _taker(self, topic: Topic) -> Any:
        recorder = self._recorder
        assert recorder is not None

        def take(payload: bytes) -> None:
            recorder.take(topic, payload)
            self._tell()
            if recorder.error is not None:
                self.fail(recorder.error)

        return take


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(RecorderNode, args)


if __name__ == "__main__":
    main()
