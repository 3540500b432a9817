"""`pallet-twin view` as a process: on the loopback alone, without a display, beside a graph that it doesn't disturb."""

import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from config.errors import RefusedInput
from ros_nodes.view import view
from tests.recordings.rrd_rows import moving, rows_of
from tests.ros_nodes.graph import counts, environment, missing_of, pallet_twin, payloads
from tests.ros_nodes.sockets import family, listening

SHOW = """
import signal, sys
# A job in the background of a shell has its interrupts ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
from pathlib import Path
from config.errors import PalletTwinError
from ros_nodes.view import view
bag, save = sys.argv[1], sys.argv[2]
try:
    view(
        Path(bag) if bag else None, live=not bag, web=True, save=Path(save) if save else None,
        data_port=0, page_port=0, on_page=lambda url: print("view at", url, flush=True),
    )
except PalletTwinError as error:
    sys.exit(str(error))
"""
LIGHT = """
import sys
import ros_nodes.cli, ros_nodes.view, ros_nodes.viewer_node
assert not [name for name in sys.modules if name.startswith("rerun")]
sys.modules["rerun"] = None
ros_nodes.view.view(None, live=True, web=True)
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("slip")
    done = pallet_twin("run", "block_slip", "--no-estimate", "--no-page", "--out", "out", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "out" / "bag"


@contextmanager
def showing(
    bag: Path | str, *, save: Path | str = "", env: dict[str, str] | None = None
) -> Iterator[tuple[int, str]]:
    """A view as a process; its number and its page's address. It must end well when it is asked to."""
    process = subprocess.Popen(
        [sys.executable, "-c", SHOW, str(bag), str(save)], env=env or environment(),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = next((line for line in process.stdout if "view at http" in line), "")
        yield process.pid, line.split()[-1]
        process.send_signal(signal.SIGTERM if not bag else signal.SIGINT)
        rest = process.communicate(timeout=60)[0]
        assert process.returncode == (0 if not bag else -signal.SIGINT), rest
    finally:
        process.kill()
        process.communicate()


def test_command_line_does_not_load_rerun_and_says_when_it_lacks() -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, timeout=60)
    assert "RefusedInput: view = rerun-sdk: is not installed: pip install 'pallet-twin[view]'" in done.stderr


def test_page_of_a_bag_stands_on_the_loopback_alone(bag: Path) -> None:
    with showing(bag) as (pid, url):
        assert url.startswith("http://127.0.0.1:")
        assert listening(pid) == {"0100007F"}
        assert len(family(pid)) == 1
        with urllib.request.urlopen(url) as answer:
            policy = answer.headers["Content-Security-Policy"]
            page = answer.read().decode()
        assert "default-src 'none'" in policy and "connect-src 'self' http://127.0.0.1:" in policy
        assert "rerun+http://127.0.0.1:" in page and "https://" not in page
        with urllib.request.urlopen(f"{url}re_viewer_bg.wasm") as answer:
            assert answer.read(4) == b"\0asm"
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(f"{url}../etc/passwd")


def test_live_view_shows_the_test_from_its_first_frame_and_disturbs_nothing(
    bag: Path, tmp_path: Path
) -> None:
    file, env = tmp_path / "live.rrd", environment()
    env = {**env, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with showing("", save=file, env=env) as (pid, _):
        up = pallet_twin(
            "up", "block_slip", "--no-estimate", "--no-page", "--out", "up", cwd=tmp_path, env=env
        )
        assert up.returncode == 0, up.stderr
        assert listening(pid) == {"0100007F"}
        # It draws 30 times a second, when it is let.
        time.sleep(2.0)
    graph = tmp_path / "up" / "bag"
    assert list(missing_of(graph)) == []
    assert payloads(graph, "/twin/packages/poses") == payloads(bag, "/twin/packages/poses")
    rows = rows_of(file)
    times, _ = moving(rows, "/world/sled/packages", "Boxes3D:centers")
    frames = counts(graph)["/twin/packages/poses"]
    assert 2 <= len(times) < frames
    # Views may lose frames, the last ones too, and most of them where both cores are busy.
    assert times[0] < 0.1 and times[0] < times[-1] < frames / 240.0
    lines = [line[0] for line in moving(rows, "/log", "TextLog:text")[1]]
    assert any(line.startswith("verdict: ") for line in lines)
    assert any(line.startswith("physics finished") for line in lines)
    assert any(line.startswith(f"shown: {len(times)} of ") for line in lines), lines
    view(bag, save=tmp_path / "bag.rrd")
    states = [
        moving(found, "/rules/permanent", "StateChange:state")
        for found in (rows, rows_of(tmp_path / "bag.rrd"))
    ]
    # Live times count from the first frame that arrived.
    assert states[0][1] == states[1][1] and [state[0] for state in states[0][1]] == ["pass", "fail"]
    band = next(path for path in rows if path.startswith("/plots/displacement/band_"))
    shifts = np.ravel(moving(rows, band, "Scalars:scalars")[1])
    # The block slides by 467.5 mm, see the README; the last frame that is shown need not be the last.
    assert 0.0 <= shifts[-1] < 468.0


def test_saves_a_file_and_refuses_to_write_over_one(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "view.rrd"
    view(bag, save=file)
    assert file.read_bytes().startswith(b"RRF")
    with pytest.raises(RefusedInput, match=r"new \.rrd file"):
        view(bag, save=file)
    with pytest.raises(RefusedInput, match="does not exist"):
        view(tmp_path / "none", save=tmp_path / "other.rrd")
    assert not (tmp_path / "other.rrd").exists()


def test_window_needs_a_display(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RefusedInput, match="--web serves a page"):
        view(bag)
    with pytest.raises(RefusedInput, match="needs a BAG or --live"):
        view(None)
    with pytest.raises(RefusedInput, match="needs a BAG or --live"):
        view(bag, live=True)
    assert os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE") is None
