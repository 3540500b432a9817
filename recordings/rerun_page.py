"""A rerun recording shown on this host alone: data and page on 127.0.0.1, and nothing fetched from elsewhere.

rerun's own ``serve_web_viewer`` listens on every interface, and its page asks other hosts for fonts, news and usage
counts. So rerun's viewer, a WebAssembly module, is handed out here by a page of our own that forbids the browser
every other address.
"""

import contextlib
import json
import os
import socket
import subprocess
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import rerun as rr

from config.errors import RefusedInput

APPLICATION = "pallet-twin"
CLOSE_LIMIT_S = 10.0
LOOPBACK = "127.0.0.1"
MEMORY_LIMIT = "1GiB"
"""What the server keeps for viewers that come late; the oldest goes first, what is static never."""
BATCH_S = 0.2
"""How often what is logged is sent [s]."""
_START_TIMEOUT_S = 20.0
_SCRIPT, _MODULE = "re_viewer.js", "re_viewer_bg.wasm"
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>pallet-twin</title><link rel="icon" href="data:,">
<style>html,body{margin:0;height:100%;overflow:hidden;background:#0d1011;color:#cad8de;font:14px sans-serif}
canvas{position:absolute;inset:0;width:100%;height:100%}p{padding:2em}</style></head>
<body><p id="word">Loading the viewer …</p><canvas id="view"></canvas>
<script src="SCRIPT"></script>
<script>
const word = document.getElementById("word");
wasm_bindgen({module_or_path: "MODULE"}).then(() => {
  const handle = new wasm_bindgen.WebHandle({
    url: [DATA], hide_welcome_screen: true, check_for_updates_on_startup: false, persist: false, theme: "dark",
    enable_history: false,
  });
  return handle.start(document.getElementById("view")).then(() => word.remove());
}).catch(error => { word.textContent = "The viewer did not start: " + error; });
</script></body></html>
"""


def free_port(port: int) -> int:
    """The port itself when nobody on this host listens there, or any free one for 0.

    Raises:
        RefusedInput: it is taken.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except (OSError, OverflowError):
            raise RefusedInput("port", port, "must be free on 127.0.0.1; 0 takes any that is") from None
        return int(probe.getsockname()[1])


class DataServer:
    """Keeps recordings on 127.0.0.1 for viewers, those that come late too.

    Args:
        port: 0 takes a free one.

    Attributes:
        url: what a viewer connects to, ``rerun+http://127.0.0.1:PORT/proxy``.
        port: where it listens.

    Raises:
        RefusedInput: the port is taken.
    """

    def __init__(self, *, port: int = 0) -> None:
        self.port = free_port(port)
        # A server belongs to a recording; nothing is logged to this one, so viewers do not see it.
        self._host = rr.RecordingStream(APPLICATION, send_properties=False)
        sink = rr.GrpcServerSink(bind_ip=LOOPBACK, port=self.port, server_memory_limit=MEMORY_LIMIT)
        self._host.set_sinks(sink)
        self.url = sink.uri
        self._recordings: list[rr.RecordingStream] = []

    def recording(self, name: str, *, save: Path | None = None) -> rr.RecordingStream:
        """A new recording that is served, and goes into a file too where one is named."""
        # Live, rerun would send every few milliseconds, and a viewer takes in so many pieces too slowly.
        batches = rr.ChunkBatcherConfig()
        batches.flush_tick = BATCH_S
        recording = rr.RecordingStream(APPLICATION, batcher_config=batches)
        served = rr.GrpcSink(self.url)
        if save is None:
            recording.set_sinks(served)
        else:
            recording.set_sinks(served, rr.FileSink(save))
        recording.send_recording_name(name)
        self._recordings.append(recording)
        return recording

    def close(self) -> None:
        """Sends what is on its way, finishes files, and ends the server; what takes longer than a while is left."""
        ending = threading.Thread(target=self._disconnect, daemon=True)
        ending.start()
        ending.join(CLOSE_LIMIT_S)

    def _disconnect(self) -> None:
        for recording in self._recordings:
            recording.disconnect()
        self._host.disconnect()


class ViewerPage:
    """rerun's viewer at ``http://127.0.0.1:PORT/``, showing what is served.

    Args:
        data: what it shows.
        port: 0 takes a free one.

    Raises:
        RefusedInput: the port is taken, or rerun's program does not start.
    """

    def __init__(self, data: DataServer, *, port: int = 0) -> None:
        port = free_port(port)
        page = (
            _PAGE.replace("SCRIPT", _SCRIPT).replace("MODULE", _MODULE).replace("DATA", json.dumps(data.url))
        )
        files = {
            "/": ("text/html; charset=utf-8", page.encode()),
            **{f"/{name}": (kind, content) for name, kind, content in _viewer_files()},
        }
        policy = (
            "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; "
            f"img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self' http://{LOOPBACK}:{data.port}"
        )

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                kind, content = files.get(self.path.partition("?")[0], ("", b""))
                if not kind:
                    self.send_error(HTTPStatus.NOT_FOUND)
                    return
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Content-Security-Policy", policy)
                self.end_headers()
                with contextlib.suppress(ConnectionError):
                    self.wfile.write(content)

            def log_message(self, format: str, *args: object) -> None:
                """A page asked for is no news."""

        self._server = ThreadingHTTPServer((LOOPBACK, port), Handler)
        self._server.daemon_threads = True
        self.url = f"http://{LOOPBACK}:{port}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Serves no more."""
        self._server.shutdown()
        self._server.server_close()


def require_display() -> None:
    """Refuses a window where there is no screen to open it on.

    Raises:
        RefusedInput: there is none.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise RefusedInput(
            "view", "no display", "needs one for a window; --web serves a page, --save FILE a file"
        )


def open_window(data: DataServer) -> "subprocess.Popen[bytes]":
    """A window of rerun, showing what is served; it ends when the user closes it.

    Raises:
        RefusedInput: there is no display.
    """
    require_display()
    command = [_program(), "--bind", LOOPBACK, "--port", "auto", data.url]
    return subprocess.Popen(command, env=_quiet(), stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _viewer_files() -> Iterator[tuple[str, str, bytes]]:
    """Name, type and bytes of the viewer, as rerun's program carries them in itself."""
    data_port, page_port = free_port(0), free_port(0)
    with tempfile.TemporaryDirectory(prefix="pallet-twin-view-") as home:
        process = subprocess.Popen(
            [_program(), "--serve-web", "--bind", LOOPBACK, "--port", str(data_port),
             "--web-viewer-port", str(page_port)],
            env=_quiet() | {"HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home},
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            for name, kind in ((_SCRIPT, "text/javascript"), (_MODULE, "application/wasm")):
                yield name, kind, _fetched(f"http://{LOOPBACK}:{page_port}/{name}", process)
        finally:
            process.kill()
            process.wait()


def _fetched(url: str, process: "subprocess.Popen[bytes]") -> bytes:
    deadline = time.monotonic() + _START_TIMEOUT_S
    # Proxies are for other hosts.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while process.poll() is None and time.monotonic() < deadline:
        try:
            with opener.open(url, timeout=_START_TIMEOUT_S) as answer:
                return bytes(answer.read())
        except urllib.error.URLError:
            time.sleep(0.05)
    raise RefusedInput("view", "rerun", "its program did not start; see `rerun --version`")


def _program() -> str:
    """The program of rerun, beside its module; the script of that name would start it as a child of its own."""
    return str(Path(rr.__file__).parent.with_name("rerun_cli") / "rerun")


def _quiet() -> dict[str, str]:
    """An environment in which rerun counts and reports no use: there is no other switch by environment."""
    return {**os.environ, "CI": "true"}


def save_bag(bag: Path, file: Path) -> None:
    """Writes a bag's view, blueprint included, as a file that rerun opens.

    Raises:
        BrokenRecording: the bag is damaged, or holds no scene or no poses; no file is left then.
    """
    from recordings.rerun_view import view_bag

    recording = rr.RecordingStream(APPLICATION)
    recording.save(file)
    try:
        view_bag(bag, recording)
    except BaseException:
        recording.disconnect()
        file.unlink(missing_ok=True)
        raise
    recording.disconnect()
