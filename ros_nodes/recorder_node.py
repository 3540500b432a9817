"""Writes every topic of the graph, unparsed, into a bag."""

import time
from pathlib import Path
from typing import Any

from config.errors import RefusedInput
from msgs_adapters.topics import ALL_TOPICS, TF, Topic
from recordings.graph_recorder import GraphRecorder
from ros_nodes.node_process import TwinNode, run_node

QUIET_FOR_S = 0.3
DRAIN_LIMIT_S = 10.0


class RecorderNode(TwinNode):
    """Subscribes raw to the topics named in ``topics`` and records them into ``bag``.

    When it is asked to end it first takes in what is still on its way: it ends once nothing has arrived
    for a while, and finishes the bag. Holes in the stamps of regular topics are counted and written into
    the bag.
    """

    def __init__(self) -> None:
        super().__init__("recorder_node")
        self._directory = self.declare("bag", "", "directory of the bag; must not exist, or be empty")
        self._topic_names = self.declare("topics", "", "relative topic names, comma-separated; empty for all")
        self._recorder: GraphRecorder | None = None
        self._asked_to_end: float | None = None

    def set_up(self) -> bool:
        """Opens the bag and subscribes."""
        if not self._directory:
            raise RefusedInput("bag", "empty", "name a directory")
        known = {topic.name: topic for topic in ALL_TOPICS if topic is not TF}
        names = self._topic_names.split(",") if self._topic_names else list(known)
        unknown = [name for name in names if name not in known]
        if unknown:
            raise RefusedInput("topics", unknown[0], f"must be one of {', '.join(known)}")
        topics = [known[name] for name in names]
        self._recorder = GraphRecorder(Path(self._directory), topics, namespace=self.get_namespace())
        for topic in topics:
            self.listen(topic, self._taker(topic), raw=True)
        return True

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
        for name, missing in self._recorder.gaps.items():
            self.get_logger().error(f"{missing} messages of {name} never arrived")
        if self._recorder.error is not None:
            self.fail(self._recorder.error)

    def _taker(self, topic: Topic) -> Any:
        recorder = self._recorder
        assert recorder is not None

        def take(payload: bytes) -> None:
            recorder.take(topic, payload)
            if recorder.error is not None:
                self.fail(recorder.error)

        return take


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(RecorderNode, args)


if __name__ == "__main__":
    main()
