"""Shows the test live in rerun, without being able to slow it."""

import struct
import subprocess
from collections import deque
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from config.errors import PalletTwinError, RefusedInput
from config.scene_file import scene_from_json
from msgs_adapters.cdr import ENCAPSULATION
from msgs_adapters.topics import (
    CAMERA_COMPRESSED,
    CAMERA_INFO,
    EUMOS_REPORT,
    EUMOS_STATUS,
    PACKAGES_POSES,
    PHYSICS_PROGRESS,
    SCENE,
    SLED_ACCELERATION,
    SLED_ACCELEROMETER,
    SLED_ODOMETRY,
    VIEW,
    WRAP_STRAIN,
    QosSpec,
    Topic,
)
from ros_nodes.node_process import TwinNode, run_node

if TYPE_CHECKING:
    from recordings.rerun_page import DataServer, ViewerPage
    from recordings.rerun_view import RerunView

DATA_PORT, PAGE_PORT = 9876, 9090
"""Those that rerun itself uses."""
FRAMES_HZ = 30.0
SAMPLES_HZ = 240.0
_TICKS_A_PICTURE = 3
_TICKS_A_PLOT = 6
ALL = float("inf")
_LOSSY = QosSpec(reliability="best_effort", depth=VIEW.depth)
_LOSSY_PICTURES = QosSpec(reliability="best_effort", depth=5)
_MOST_WAITING = 20_000
_STAMP = struct.Struct("<iI")

CONFLATED = (SLED_ODOMETRY, PACKAGES_POSES, WRAP_STRAIN, CAMERA_COMPRESSED, CAMERA_INFO)
"""Of these the newest message is drawn at each tick, and what it overtook is counted."""
SAMPLED = (SLED_ACCELERATION, SLED_ACCELEROMETER)
"""Of these one is drawn every ``1 / SAMPLES_HZ`` of simulated time."""
WHOLE = (EUMOS_STATUS, EUMOS_REPORT, PHYSICS_PROGRESS)
"""Of these every one is drawn."""
VIEWED = (*CONFLATED, *SAMPLED, *WHOLE, SCENE)


class ViewerNode(TwinNode):
    """The live view as a node; it publishes nothing.

    Streams are read best effort and only kept, as bytes; a clock draws the newest of each, 30 times a second, and
    pictures ten times. When a new test begins, so does a new recording in the same viewer.
    """

    def __init__(self) -> None:
        super().__init__("viewer_node")
        self._data_port = self.declare(
            "data_port", DATA_PORT, "rerun's data on 127.0.0.1; 0: any free", from_value=0, to_value=65535
        )
        self._page_port = self.declare(
            "page_port", PAGE_PORT, "web page on 127.0.0.1; 0: any free", from_value=0, to_value=65535
        )
        self._window = self.declare("window", False, "open a window of rerun in place of the web page")
        self._save = self.declare("save", "", "also write what is shown into this .rrd file")
        self._starts_itself = self.declare("autostart", False, "become active without a supervisor")
        self._server: DataServer | None = None
        self._page: ViewerPage | None = None
        self._open: subprocess.Popen[bytes] | None = None
        self._view: RerunView | None = None
        self._forget()
        if self._starts_itself:
            self.trigger_configure()
            self.trigger_activate()

    def _forget(self) -> None:
        """Begins without a message of a test."""
        self._newest: dict[Topic, bytes] = {}
        self._waiting: deque[tuple[Topic, bytes]] = deque(maxlen=_MOST_WAITING)
        self._due_ns: dict[Topic, float] = {}
        self.received: dict[str, int] = {}
        self.dropped: dict[str, int] = {}
        self._ticks = 0

    def set_up(self) -> bool:
        """Opens the server on the loopback, the page or the window, and the subscriptions."""
        require_rerun()
        from recordings.rerun_page import DataServer, ViewerPage, open_window

        self._server = DataServer(port=self._data_port)
        if self._window:
            self._open = open_window(self._server)
        else:
            self._page = ViewerPage(self._server, port=self._page_port)
            self.get_logger().info(f"view at {self._page.url}")
        self.listen(SCENE, self._take_scene)
        for topic in CONFLATED:
            qos = _LOSSY_PICTURES if topic == CAMERA_COMPRESSED else _LOSSY
            self.listen(replace(topic, qos=qos), partial(self._keep_newest, topic), raw=True)
        for topic in SAMPLED:
            self.listen(replace(topic, qos=_LOSSY), partial(self._keep_sample, topic), raw=True)
        for topic in WHOLE:
            self.listen(topic, partial(self._keep, topic), raw=True)
        self.create_timer(1.0 / FRAMES_HZ, self._draw)
        return True

    def on_end(self) -> None:
        """Draws what is left, and closes page and server."""
        if self._view is not None:
            self._draw_all()
        if self._open is not None:
            self._open.terminate()
            self._open.wait()
        if self._page is not None:
            self._page.close()
        if self._server is not None:
            self._server.close()

    def _take_scene(self, message: Any) -> None:
        from recordings.rerun_view import RerunView

        assert self._server is not None
        if self._view is not None:
            self._draw_all()
            self._forget()
        try:
            scene = scene_from_json(message.data)
        except PalletTwinError as error:
            self.get_logger().warning(f"not shown: {error}")
            return
        # Only the first test that it sees: the next would take its file away.
        save, self._save = Path(self._save) if self._save else None, ""
        recording = self._server.recording(scene.name, save=save)
        self._view = RerunView(scene, recording, frames_hz=ALL, pictures_hz=ALL)

    def _keep(self, topic: Topic, payload: bytes) -> None:
        self.received[topic.name] = self.received.get(topic.name, 0) + 1
        self._waiting.append((topic, payload))

    def _keep_newest(self, topic: Topic, payload: bytes) -> None:
        count = self.received[topic.name] = self.received.get(topic.name, 0) + 1
        if count == 1:
            # Displacement counts from the first frame, which must not be overtaken.
            self._waiting.append((topic, payload))
            return
        if topic in self._newest:
            self.dropped[topic.name] = self.dropped.get(topic.name, 0) + 1
        self._newest[topic] = payload

    def _keep_sample(self, topic: Topic, payload: bytes) -> None:
        self.received[topic.name] = self.received.get(topic.name, 0) + 1
        seconds, nanoseconds = _STAMP.unpack_from(payload, len(ENCAPSULATION))
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        if stamp_ns < self._due_ns.get(topic, 0.0):
            self.dropped[topic.name] = self.dropped.get(topic.name, 0) + 1
            return
        self._due_ns[topic] = stamp_ns + 0.99e9 / SAMPLES_HZ
        self._waiting.append((topic, payload))

    def _draw(self) -> None:
        """What a tick draws; a window that the user closed ends the node."""
        if self._open is not None and self._open.poll() is not None:
            self.done = True
        if self._view is None:
            return
        self._ticks += 1
        while self._waiting:
            self._show(*self._waiting.popleft())
        for topic in CONFLATED:
            if topic in self._newest and (topic != CAMERA_COMPRESSED or self._ticks % _TICKS_A_PICTURE == 0):
                self._show(topic, self._newest.pop(topic))
        if self._ticks % _TICKS_A_PLOT == 0:
            self._view.flush()

    def _draw_all(self) -> None:
        assert self._view is not None
        self._ticks = -1
        self._draw()
        self._say_what_was_dropped()
        self._view.finish()

    def _show(self, topic: Topic, payload: bytes) -> None:
        assert self._view is not None
        try:
            self._view.take(topic, payload)
        except PalletTwinError as error:
            # A view must not end a test.
            self._view.say(f"not shown: {error}", level="ERROR")
        if topic == EUMOS_REPORT:
            self._say_what_was_dropped()

    def _say_what_was_dropped(self) -> None:
        assert self._view is not None
        shown = [
            f"{self.received[topic.name] - self.dropped.get(topic.name, 0)} of {self.received[topic.name]} {name}"
            for topic, name in (
                (PACKAGES_POSES, "frames"),
                (WRAP_STRAIN, "films"),
                (CAMERA_COMPRESSED, "pictures"),
            )
            if topic.name in self.received
        ]
        if shown:
            self._view.say(f"shown: {', '.join(shown)}")


def require_rerun() -> None:
    """Refuses to show anything where rerun is not installed.

    Raises:
        RefusedInput: it is not.
    """
    if find_spec("rerun") is None:
        raise RefusedInput("view", "rerun-sdk", "is not installed: pip install 'pallet-twin[view]'")


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(ViewerNode, args)


if __name__ == "__main__":
    main()
