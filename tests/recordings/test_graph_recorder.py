"""The graph's recorder: the bytes it took, when they came, and a clear end or line whatever goes wrong."""

import os
import resource
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from config.errors import BrokenRecording, RefusedInput
from config.scene import Scene
from config.scene_file import find_scene, read_scene, scene_from_json
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_string
from msgs_adapters.publications import image_publication
from msgs_adapters.topics import (
    CAMERA_IMAGE,
    CLOCK,
    PACKAGES_POSES,
    SCENE,
    SLED_ODOMETRY,
    Topic,
)
from recordings import graph_recorder
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.graph_recorder import GraphRecorder
from recordings.rescue import recover_bag

EPOCH_NS = 10**12


@pytest.fixture(scope="module")
def scene() -> Scene:
    return read_scene(find_scene("block_slip"), [])


def clock(time_s: float) -> bytes:
    seconds, nanoseconds = divmod(EPOCH_NS + round(time_s * 1e9), 10**9)
    return b"\0\1\0\0" + struct.pack("<iI", seconds, nanoseconds)


def picture(index: int) -> bytes:
    """57 kB that cannot be compressed."""
    noise = np.random.default_rng(index).integers(0, 256, (120, 160, 3), dtype=np.uint8)
    return image_publication(EPOCH_NS + index * 10**7, noise).payload


def settle(recorder: GraphRecorder) -> None:
    """Waits until everything taken is written, or until nothing can be."""
    deadline = time.monotonic() + 10.0
    while recorder._count and time.monotonic() < deadline:
        time.sleep(0.005)


@contextmanager
def files_no_larger_than(size: int) -> Iterator[None]:
    """A full disk for everybody: the kernel refuses what makes a file larger."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_reception_is_kept_beside_simulated_time(tmp_path: Path, scene: Scene) -> None:
    began_ns = time.time_ns()
    recorder = GraphRecorder(tmp_path / "bag", [SCENE, CLOCK])
    recorder.take(SCENE, serialize(to_string(scene.to_json())))
    for index in range(3000):
        recorder.take(CLOCK, clock(index / 1000))
        if index % 1000 == 0:
            time.sleep(0.6)
    recorder.close()
    ended_ns = time.time_ns()
    with BagReader(tmp_path / "bag") as reader:
        messages = list(reader.messages(["/clock"]))
        assert [message.payload for message in messages] == [clock(index / 1000) for index in range(3000)]
        assert messages[-1].log_time_ns == EPOCH_NS + 2_999_000_000
        sequences, times_ns = reader.receive_times("/clock")
        assert sequences.tolist() == [message.sequence for message in messages] == list(range(3000))
        assert began_ns - 1000 < times_ns[0] and times_ns[-1] < ended_ns
        steps_ms = np.diff(times_ns) / 1e6
        assert steps_ms.min() >= 0.0 and np.flatnonzero(steps_ms > 550.0).tolist() == [0, 1000, 2000]
        assert reader.receive_times("/twin/scene")[0].tolist() == [0]
        assert reader.attachment_names == ["scene.json"]
        with pytest.raises(BrokenRecording, match="no such"):
            reader.receive_times("/nothing")
        stored = [
            index
            for index in reader._parts[0].summary.metadata_indexes
            if index.name == "pallet-twin receive times"
        ]
        # Some digits a message; three times a pause of 0.6 s, longer than one record waits.
        assert len(stored) > 2 and sum(index.length for index in stored) < 5 * 3000 + 200 * len(stored)
        assert reader.metadata_names == ["pallet-twin recorder", "rosbag2"]


def test_a_bag_without_a_graph_has_no_reception(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(writer.add_topic(CLOCK), clock(0), log_time_ns=EPOCH_NS)
    with BagReader(tmp_path / "bag") as reader:
        assert [len(part) for part in reader.receive_times("/clock")] == [0, 0]


def test_a_full_disk_ends_the_recording_and_leaves_a_whole_bag(tmp_path: Path, scene: Scene) -> None:
    with files_no_larger_than(2_000_000):
        recorder = GraphRecorder(tmp_path / "bag", [SCENE, CAMERA_IMAGE])
        recorder.take(SCENE, serialize(to_string(scene.to_json())))
        for index in range(100):
            recorder.take(CAMERA_IMAGE, picture(index))
        recorder.close()
    assert (
        recorder.error == "the bag cannot be written: File too large; what was written until then can be read"
    )
    with BagReader(tmp_path / "bag") as reader:
        reader.verify()
        pictures = [message.payload for message in reader.messages(["/twin/camera/image_raw"])]
        # 34 pictures of 57 kB fill 2 MB; a few make room for scene and index.
        assert 25 <= len(pictures) <= 34
        assert pictures == [picture(index) for index in range(len(pictures))]
        assert scene_from_json(reader.attachment("scene.json").decode()) == scene
        assert reader.metadata("pallet-twin recorder")["received camera/image_raw"] == "100"


def test_a_full_file_system_too(tmp_path: Path, scene: Scene) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("needs the right to mount a file system")
    try:
        recorder = GraphRecorder(disk / "bag", [SCENE, CAMERA_IMAGE], split_bytes=500_000)
        recorder.take(SCENE, serialize(to_string(scene.to_json())))
        for index in range(100):
            recorder.take(CAMERA_IMAGE, picture(index))
        recorder.close()
        assert recorder.error is not None and "No space left on device" in recorder.error
        with BagReader(disk / "bag") as reader:
            reader.verify()
            pictures = [message.payload for message in reader.messages(["/twin/camera/image_raw"])]
            assert pictures == [picture(index) for index in range(len(pictures))]
            assert len(pictures) >= 25
        assert (disk / "bag" / "metadata.yaml").exists()
        # Room for nothing at all: the original stays as it is.
        shutil.copy(disk / "bag" / "bag_0.mcap", tmp_path / "copy.mcap")
        with pytest.raises((OSError, RefusedInput)):
            for number in range(9):
                recover_bag(tmp_path / "copy.mcap", disk / f"again{number}")
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_deleted_file_is_said(tmp_path: Path) -> None:
    recorder = GraphRecorder(tmp_path / "bag", [CLOCK])
    recorder.take(CLOCK, clock(0.0))
    settle(recorder)
    shutil.rmtree(tmp_path / "bag")
    recorder.take(CLOCK, clock(1.0))
    settle(recorder)
    recorder.close()
    assert recorder.error is not None and "was deleted while it was recorded" in recorder.error
    assert not (tmp_path / "bag").exists()


def test_a_place_without_permission_is_refused(tmp_path: Path) -> None:
    # Not even root may make a directory there.
    with pytest.raises(RefusedInput, match="cannot be made: "):
        GraphRecorder(Path("/sys/pallet_twin_bag"), [CLOCK])
    if os.geteuid() != 0:
        closed = tmp_path / "closed"
        closed.mkdir(mode=0o500)
        with pytest.raises(RefusedInput, match="cannot be written: Permission denied"):
            GraphRecorder(closed, [CLOCK])


def test_a_clock_that_jumps_back_is_told_and_nothing_is_lost(tmp_path: Path) -> None:
    recorder = GraphRecorder(tmp_path / "bag", [CLOCK])
    times = [*np.arange(0.0, 2.0, 0.01), *np.arange(0.0, 3.0, 0.01)]
    for time_s in times:
        recorder.take(CLOCK, clock(time_s))
    recorder.close()
    assert recorder.notes == ["time went back by 1.990 s in /clock: its node has started anew"]
    assert recorder.error is None
    with BagReader(tmp_path / "bag") as reader:
        messages = list(reader.messages())
        assert [message.payload for message in messages] == [clock(time_s) for time_s in times]
        log_times = [message.log_time_ns for message in messages]
        assert log_times == sorted(log_times) and log_times[-1] == EPOCH_NS + 2_990_000_000
        assert messages[200].publish_time_ns == EPOCH_NS
        assert reader.metadata("pallet-twin recorder")["time went back /clock"] == "1"


def test_bytes_that_make_no_sense_are_recorded_as_they_are(tmp_path: Path, scene: Scene) -> None:
    recorder = GraphRecorder(tmp_path / "bag", [SCENE, CLOCK, PACKAGES_POSES, SLED_ODOMETRY])
    sent: list[tuple[Topic, bytes]] = [
        (CLOCK, clock(0.0)),
        (SCENE, b"\0\1\0\0\xff\xff\xff\x7f"),
        (SCENE, serialize(to_string("{}"))),
        (SCENE, serialize(to_string(scene.to_json()))),
        (PACKAGES_POSES, clock(0.1)),
        (PACKAGES_POSES, b""),
        (SLED_ODOMETRY, clock(0.1) + b"\xff" * 40),
        (CLOCK, b"\0"),
        (CLOCK, clock(0.2)),
    ]
    for topic, payload in sent:
        recorder.take(topic, payload)
    recorder.close()
    assert recorder.error is None
    assert any("scene cannot be understood" in note for note in recorder.notes)
    with BagReader(tmp_path / "bag") as reader:
        assert [message.payload for message in reader.messages()] == [payload for _, payload in sent]


def test_falling_behind_is_told_once_and_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # No disk of a test machine is a second behind; any wait for the disk counts here.
    monkeypatch.setattr(graph_recorder, "BEHIND_S", 0.0)
    recorder = GraphRecorder(tmp_path / "bag", [CAMERA_IMAGE])
    for index in range(50):
        recorder.take(CAMERA_IMAGE, picture(index))
    recorder.close()
    (note,) = recorder.notes
    assert note.startswith("the bag fell behind by 0.0 s: ") and note.endswith(" MB wait for the disk")
    with BagReader(tmp_path / "bag") as reader:
        facts = reader.metadata("pallet-twin recorder")
    assert 1 <= int(facts["most waiting messages"]) <= 50
    assert int(facts["most waiting bytes"]) >= len(picture(0))
    assert float(facts["most behind s"]) > 0.0


def test_the_queue_is_bounded_and_the_taker_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_recorder, "QUEUE_BYTES", 4 * len(picture(0)))
    recorder = GraphRecorder(tmp_path / "bag", [CAMERA_IMAGE])
    for index in range(60):
        recorder.take(CAMERA_IMAGE, picture(index))
    recorder.close()
    with BagReader(tmp_path / "bag") as reader:
        assert reader.message_count == 60
        assert int(reader.metadata("pallet-twin recorder")["most waiting messages"]) <= 4


BEATS = """
import sys, time
from pathlib import Path
from msgs_adapters.topics import CLOCK
from recordings.graph_recorder import GraphRecorder
recorder = GraphRecorder(Path(sys.argv[1]), [CLOCK])
recorder.take(CLOCK, bytes((0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0)))
time.sleep(0.9)
print("quiet", flush=True)
time.sleep(60)
"""


def test_what_came_last_is_safe_though_nothing_follows(tmp_path: Path) -> None:
    command = [sys.executable, "-c", BEATS, str(tmp_path / "bag")]
    with subprocess.Popen(command, cwd=Path(__file__).parents[2], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"quiet\n"
        process.kill()
    assert recover_bag(tmp_path / "bag").counts["/clock"] == 1


def test_raw_pictures_are_recorded_faster_than_a_camera_gives_them(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    payload = image_publication(EPOCH_NS, noise).payload
    recorder = GraphRecorder(tmp_path / "bag", [CAMERA_IMAGE])
    began_s = time.process_time()
    for _ in range(40):
        recorder.take(CAMERA_IMAGE, payload)
    recorder.close()
    # 100 MB/s with a core for it; a busy machine must not fail the test, so CPU time.
    assert 40 * len(payload) / 1e6 / (time.process_time() - began_s) > 100.0
    assert recorder.error is None
