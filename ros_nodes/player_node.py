"""Plays a recording on the topics that it was recorded from."""

import gc
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from std_srvs.srv import SetBool, Trigger

from config.errors import PalletTwinError, RefusedInput
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import Progress, to_progress
from msgs_adapters.publications import Publication
from msgs_adapters.topics import (
    ALL_TOPICS,
    CAMERA_INFO,
    CAMERA_PROGRESS,
    CLOCK,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    PLAYER_PROGRESS,
    SLED_ACCELERATION,
    Topic,
)
from recordings.graph_recorder import STAMPED_TYPES, stamp_of
from recordings.paced_sender import PacedSender
from recordings.playback import Playback, PlayedMessage, why_incomplete
from ros_nodes.answer_window import ANSWER_LIMIT_S, AnswerWindow
from ros_nodes.node_process import FAILURE, LifecycleState, TwinNode, run_node
from ros_nodes.readers import readers_wanted

PROGRESS_PERIOD_S = 0.1
MATCHING_SETTLES_S = 0.5
ACKNOWLEDGED_BYTES = 16 * 2**20
"""So much leaves in a burst before it is waited for: a quarter of the shared memory that a node has."""
ACKNOWLEDGE_POLL_S = 0.0005
ACKNOWLEDGE_LIMIT_S = 5.0
SWITCH_INTERVAL_S = 0.0002
"""How long reading ahead may keep the interpreter from sending: Python's own 5 ms would be the timing's error."""
SLOWEST, FASTEST = 0.01, 1000.0
SENDING_NICE = -15
NO_TIME = Duration(nanoseconds=1)


class PlayerNode(TwinNode):
    """A recording as a node.

    Publishes what the bag holds, as bytes, with the quality of service it was recorded with: latched messages first,
    then the others by log time. Makes ``/clock`` where the bag has none, and at the end ``physics/progress`` (or
    ``camera/progress``), which says how many frames there were, where the bag has none and is played once from its
    start or not. ``player/progress`` says how far it is. Services: ``player/pause``, ``player/step``,
    ``player/restart``. At the start of each further pass ``/clock`` jumps back.
    """

    def __init__(self) -> None:
        super().__init__("player_node")
        # A node that sends the time must not follow it.
        self._bag = self.declare("bag", "", "directory of the bag, or the .mcap file")
        self._rate = self.declare(
            "rate", 1.0, "seconds of the bag a second, 0.01 to 1000; 0: as fast as its readers acknowledge",
            from_value=0.0, to_value=FASTEST,
        )  # fmt: skip
        self._start_s = self.declare(
            "start_s", 0.0, "where it begins, after the first message [s]", from_value=0.0, to_value=1e9
        )
        self._passes = self.declare(
            "passes", 1, "how often; 0: until it is ended", from_value=0, to_value=10**9
        )
        self._namespace = self.declare(
            "namespace", "", "where the recorded namespace's topics go: TO or FROM:=TO; empty: they stay"
        )
        self._topics = self.declare("topics", "", "names or patterns with *, comma-separated; empty: all")
        self._leave_out = self.declare("leave_out", "", "names or patterns of what is not played")
        self._clock_hz = self.declare(
            "clock_hz", 100.0, "ticks of a /clock made for a bag without one; 0: none", from_value=0.0,
            to_value=10_000.0,
        )  # fmt: skip
        self._step = self.declare(
            "step", "frame", "'frame': to the next pose frame; 'time': to the next log time"
        )
        self._paused = self.declare("paused", False, "begin halted, for player/step or player/pause to go on")
        self._readers = self.declare(
            "readers",
            "",
            "matched readers to wait for, topic=count, comma-separated; empty: those that are there",
        )
        self._answers = self.declare(
            "answers",
            "",
            "stamped topics on which readers answer; never further ahead of them than ahead_frames",
        )
        self._ahead_frames = self.declare(
            "ahead_frames", 2000, "pose frames that may be unanswered", from_value=1, to_value=1_000_000
        )
        self._playback: Playback | None = None
        self._sender: PacedSender | None = None
        self._thread: threading.Thread | None = None
        self._unacknowledged: dict[Topic, tuple[int, int]] = {}
        self._window: AnswerWindow | None = None
        self._not_acknowledged: set[str] = set()
        self._was_told = self._has_ended = False

    def set_up(self) -> bool:
        """Opens the bag, its topics, and the services."""
        if self._sender is not None:
            return True
        self._check_parameters()
        playback = Playback(
            Path(self._bag), topics=_names(self._topics), leave_out=_names(self._leave_out),
            namespace=self._namespace, start_s=self._start_s, clock_hz=self._clock_hz,
        )  # fmt: skip
        self._playback = playback
        self._poses = self._sent_as(PACKAGES_POSES)
        self._sender = PacedSender(
            playback.opening(),
            playback.stream,
            self._send_played,
            start_ns=playback.start_ns,
            rate=self._rate or None,
            passes=self._passes,
            step=self._poses if self._step == "frame" else None,
            halted=self._paused,
        )
        self._endings = [
            (counted, ending.in_namespace(playback.selection.namespace))
            for counted, ending in ((PACKAGES_POSES, PHYSICS_PROGRESS), (CAMERA_INFO, CAMERA_PROGRESS))
            if self._sent_as(counted) is not None and self._is_missing(ending)
        ]
        made = [CLOCK] if playback.makes_clock else []
        for topic in (*playback.selection.sent.values(), *made, *(ending for _, ending in self._endings)):
            self.open_topic(topic)
        self.open_topic(PLAYER_PROGRESS)
        answers = self._answer_topics()
        if answers:
            self._window = AnswerWindow([topic.name for topic in answers], self._ahead_frames)
        for topic in answers:
            self.listen(topic, self._taker(topic), raw=True)
        self._wanted = {self._absolute(name): count for name, count in readers_wanted(self._readers).items()}
        self.create_service(SetBool, "player/pause", self._on_pause)
        self.create_service(Trigger, "player/step", self._on_step)
        self.create_service(Trigger, "player/restart", self._on_restart)
        for name, why in playback.selection.left_out.items():
            self.get_logger().warning(f"{name} is not played: {why}")
        return True

    def on_activate(self, state: LifecycleState) -> Any:
        """Sends the latched messages and, once every reader is matched, starts to play."""
        assert self._sender is not None and self._playback is not None
        sent = self._playback.selection.sent.values()
        latched = {topic.name for topic in sent if topic.qos.durability == "transient_local"}
        wanted = self._wanted
        missing = self.wait_for_readers({name: wanted[name] for name in wanted if name in latched})
        if missing is None:
            self._refuse_other_senders()
            if self.error is not None:
                return FAILURE
            if not self._was_told:
                self._sender.send_opening()
                self._was_told = True
            # Some readers listen to more once they know the scene.
            missing = self.wait_for_readers(wanted)
        if missing is not None:
            self.get_logger().error(f"no reader for {missing}")
            return FAILURE
        if not wanted:
            self._wait_until_matching_settles()
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._timer = self.create_timer(PROGRESS_PERIOD_S, self._tell_progress)
        # A collection of all that the imports left would be a pause of some milliseconds.
        gc.collect()
        gc.freeze()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._began, self._cpu_s = time.monotonic(), time.process_time()
        self._thread.start()
        return super().on_activate(state)

    def on_stop(self) -> bool:
        """Stops before the next message."""
        if self._sender is not None:
            self._sender.stop()
        return self._thread is None or not self._thread.is_alive()

    def on_end(self) -> None:
        """Sees that every reader has everything, unless it was stopped."""
        if self._has_ended:
            self.wait_for_acknowledgement()
        if self._playback is not None:
            self._playback.close()

    def _check_parameters(self) -> None:
        if not self._bag:
            raise RefusedInput("bag", "empty", "name a bag")
        if self._rate and self._rate < SLOWEST:
            raise RefusedInput("rate", self._rate, f"must be 0 or from {SLOWEST} to {FASTEST:.0f}")
        if self._step not in ("frame", "time"):
            raise RefusedInput("step", self._step, "must be 'frame' or 'time'")

    def _sent_as(self, topic: Topic) -> Topic | None:
        """A topic of the bench as it is played here."""
        assert self._playback is not None
        selection = self._playback.selection
        recorded = selection.recorded(topic)
        return selection.sent[recorded] if recorded is not None else None

    def _is_missing(self, ending: Topic) -> bool:
        """Whether the bag has no such topic, and nobody asked to leave it out."""
        assert self._playback is not None
        known = self._playback.reader.topics
        has_it = any(name.endswith(f"/{ending.name}") for name in known)
        return not has_it and not self._playback.is_left_out(ending)

    def _absolute(self, name: str) -> str:
        assert self._playback is not None
        space = self._playback.selection.namespace
        absolute = name if name.startswith("/") else f"{space.rstrip('/')}/{name}"
        if absolute not in {topic.name for topic in self._publishers_by_topic}:
            raise RefusedInput("readers", name, "is not played")
        return absolute

    def _answer_topics(self) -> list[Topic]:
        assert self._playback is not None
        known = {topic.name: topic for topic in ALL_TOPICS if topic.type_name in STAMPED_TYPES}
        found = []
        for name in _names(self._answers):
            if name not in known or self._sent_as(known[name]) is not None:
                raise RefusedInput("answers", name, "must be a stamped topic of the bench that is not played")
            found.append(known[name].in_namespace(self._playback.selection.namespace))
        if found and self._poses is None:
            raise RefusedInput("answers", self._answers, "needs packages/poses among what is played")
        return found

    def _taker(self, topic: Topic) -> Callable[[bytes], None]:
        def take(payload: bytes) -> None:
            assert self._window is not None
            self._window.take(topic.name, stamp_of(topic, payload) or 0)

        return take

    def _refuse_other_senders(self) -> None:
        """Two senders on a topic would be mixed, and two on /clock make time jump."""
        for topic in self._publishers_by_topic:
            if topic is not PLAYER_PROGRESS and self.count_publishers(topic.name) > 1:
                limit = (
                    "another node publishes it: leave it out, or play in another namespace or ROS_DOMAIN_ID"
                )
                self.error, self.done = RefusedInput("topic", topic.name, limit), True
                return

    def _wait_until_matching_settles(self) -> None:
        """Without a number to wait for: until no further reader has been found for a while."""
        matched, since = -1, time.monotonic()
        while time.monotonic() - since < MATCHING_SETTLES_S:
            now = sum(publisher.get_subscription_count() for publisher in self._publishers_by_topic.values())
            if now != matched:
                matched, since = now, time.monotonic()
            time.sleep(0.02)
        self.get_logger().info(f"{matched} readers are there")

    def _play(self) -> None:
        """The sending thread."""
        assert self._sender is not None
        try:
            self._sender.run()
            if not self._sender.is_stopped:
                self._announce_end()
                self._has_ended = True
        except PalletTwinError as error:
            self.error = error
        except Exception as error:
            # A thread's traceback would leave a node that waits for ever.
            self.failure = f"cannot play: {error!r}"
        finally:
            self._wall_s, self._cpu_s = time.monotonic() - self._began, time.process_time() - self._cpu_s

    def _send_played(self, message: PlayedMessage, is_hurried: bool) -> None:
        assert self._sender is not None
        topic = message.topic
        if is_hurried:
            self._wait_for_room(topic, len(message.payload))
        if topic is self._poses and self._window is not None:
            silent = self._window.wait_for_room(
                stamp_of(PACKAGES_POSES, message.payload) or 0, self._is_stopped
            )
            if silent is not None:
                self.failure = f"no answer on {silent} for {ANSWER_LIMIT_S:.0f} s"
                self._sender.stop()
                return
        self.send(Publication(topic, message.log_time_ns, message.payload))

    def _is_stopped(self) -> bool:
        return self._sender is not None and self._sender.is_stopped

    def _wait_for_room(self, topic: Topic, size: int) -> None:
        """Keeps a burst within half of what the topic's queue, and a share of what the shared memory, holds."""
        assert self._sender is not None
        messages, held = self._unacknowledged.get(topic, (0, 0))
        if messages >= max(1, topic.qos.depth // 2) or (messages and held + size > ACKNOWLEDGED_BYTES):
            publisher = self._publishers_by_topic[topic]
            deadline = time.monotonic() + ACKNOWLEDGE_LIMIT_S
            # A wait inside the middleware would keep the interpreter from everything else.
            while not publisher.wait_for_all_acked(NO_TIME) and not self._sender.is_stopped:
                if time.monotonic() > deadline:
                    self._not_acknowledged.add(topic.name)
                    break
                time.sleep(ACKNOWLEDGE_POLL_S)
            messages, held = 0, 0
        self._unacknowledged[topic] = (messages + 1, held + size)

    def _announce_end(self) -> None:
        """Says how many frames there were, and why that is not a whole test where it isn't."""
        assert self._sender is not None and self._playback is not None
        if self._sender.passes + self._sender.restarts != 1:
            return
        why = why_incomplete(self._playback.reader, self._playback.selection)
        if self._start_s:
            why = f"played from {self._start_s:g} s on: what stood there is not the settled load"
        for counted, ending in self._endings:
            topic, samples = self._sent_as(counted), self._sent_as(SLED_ACCELERATION)
            assert topic is not None
            count = self.published[topic.name]
            taken = self.published[samples.name] if samples is not None else count
            if count:
                values = {
                    "time_s": f"{self._sender.position_s:.6f}",
                    "pictures": str(count),
                    "of": str(count),
                }
                message = to_progress(Progress(taken, count, True, why, values))
                self.send(Publication(ending, 0, serialize(message)))

    def _tell_progress(self) -> None:
        assert self._sender is not None and self._thread is not None
        is_over = not self._thread.is_alive()
        values = {"time_s": f"{self._sender.position_s:.6f}", "passes": str(self._sender.passes)}
        if is_over:
            summary = self._summary()
            values["summary"] = json.dumps(summary)
            self.get_logger().info(played_words(summary))
        message = to_progress(
            Progress(self._sender.sent, self.published.get(self._poses.name, 0) if self._poses else 0,
                     is_over and self._has_ended, values=values)
        )  # fmt: skip
        self.send(Publication(PLAYER_PROGRESS, 0, serialize(message)))
        self.done = is_over

    def _summary(self) -> dict[str, object]:
        """What was played, and how well; see ``ros_nodes.replay.Replayed``."""
        assert self._sender is not None and self._playback is not None
        timing = self._sender.timing
        quantiles = {
            "p50_ms": timing.quantile_s(0.5),
            "p99_ms": timing.quantile_s(0.99),
            "max_ms": timing.max_s,
        }
        return {
            "messages": self._sender.sent,
            "passes": self._sender.passes,
            "wall_s": self._wall_s,
            "cpu_share": self._cpu_s / max(self._wall_s, 1e-9),
            "timing_ms": {k.removesuffix("_ms"): 1e3 * v for k, v in quantiles.items()}
            if timing.count
            else None,
            "topics": {name: count for name, count in self.published.items() if name != PLAYER_PROGRESS.name},
            "left_out": dict(self._playback.selection.left_out),
            "not_acknowledged": sorted(self._not_acknowledged),
        }

    def _on_pause(self, request: Any, response: Any) -> Any:
        assert self._sender is not None
        response.success = True
        response.message = self._sender.halt() if request.data else self._sender.go_on()
        return response

    def _on_step(self, _request: Any, response: Any) -> Any:
        assert self._sender is not None
        response.success, response.message = self._sender.step()
        return response

    def _on_restart(self, _request: Any, response: Any) -> Any:
        assert self._sender is not None
        if self._window is not None:
            self._window.forget()
        response.success, response.message = not self._sender.is_over, self._sender.restart()
        return response


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def played_words(summary: Mapping[str, Any]) -> str:
    """What was played, and how well, in one line.

    Args:
        summary: as ``player/progress`` carries it as JSON at the end.
    """
    words = f"{summary['messages']} messages in {summary['wall_s']:.2f} s"
    timing = summary["timing_ms"]
    if timing is None:
        words += ", as fast as acknowledged"
    else:
        words += ", message timing error p50 {p50:.3f}, p99 {p99:.3f}, max {max:.3f} ms".format(**timing)
    words += f", {100 * summary['cpu_share']:.0f} % of a core"
    late = ", ".join(summary["not_acknowledged"])
    return f"{words}; not acknowledged in time: {late}" if late else words


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    # On a busy machine the wake-up is most of the timing error. An ordinary user may not ask for it: then it stays.
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, SENDING_NICE)
    run_node(PlayerNode, args)


if __name__ == "__main__":
    main()
