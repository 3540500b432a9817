"""The writer gives equal bytes for equal input, overwrites nothing and leaves a whole file behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from config.errors import BrokenRecording, RefusedInput
from msgs_adapters.topics import CLOCK, PACKAGES_POSES, SCENE, QosSpec, Topic
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter


def test_equal_input_gives_equal_bytes(
    sample_bag: Path, make_bag: Callable[[Path], Path], tmp_path: Path
) -> None:
    again = make_bag(tmp_path / "sample")
    names = sorted(path.name for path in sample_bag.iterdir())
    assert names == ["metadata.yaml", "sample_0.mcap"] == sorted(path.name for path in again.iterdir())
    for name in names:
        assert (again / name).read_bytes() == (sample_bag / name).read_bytes()


def test_nothing_is_overwritten(sample_bag: Path, tmp_path: Path) -> None:
    before = (sample_bag / "sample_0.mcap").read_bytes()
    with pytest.raises(RefusedInput, match="not empty"):
        BagWriter(sample_bag)
    assert (sample_bag / "sample_0.mcap").read_bytes() == before
    (tmp_path / "file").write_text("x")
    with pytest.raises(RefusedInput, match="cannot be made"):
        BagWriter(tmp_path / "file")
    with pytest.raises(RefusedInput, match="cannot be made"):
        BagWriter(tmp_path / "file" / "below")
    (tmp_path / "empty").mkdir()
    with BagWriter(tmp_path / "empty"):
        pass
    with BagReader(tmp_path / "empty") as reader:
        assert reader.message_count == 0
        assert list(reader.messages()) == []


def test_time_topics_and_names_are_checked(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        name = bag.add_topic(PACKAGES_POSES, namespace="/machine")
        assert name == bag.add_topic(PACKAGES_POSES, namespace="/machine") == "/machine/packages/poses"
        bag.write(name, b"\0\1\0\0", log_time_ns=5)
        bag.write(name, b"\0\1\0\0", log_time_ns=5, publish_time_ns=2)
        with pytest.raises(RefusedInput, match="must not be before 5"):
            bag.write(name, b"", log_time_ns=4)
        with pytest.raises(RefusedInput, match="must be added"):
            bag.write("/clock", b"", log_time_ns=6)
        with pytest.raises(RefusedInput, match="already"):
            bag.add_topic(Topic(name, "std_msgs/msg/String", QosSpec()))
        with pytest.raises(RefusedInput, match="not installed"):
            bag.add_topic(Topic("x", "no_msgs/msg/X", QosSpec()))
        with pytest.raises(RefusedInput, match="rosbag2's own"):
            bag.add_metadata("rosbag2", {})
        assert bag.message_counts == {name: 2}
    bag.close()
    with BagReader(tmp_path / "bag") as reader:
        assert [(m.log_time_ns, m.publish_time_ns, m.sequence) for m in reader.messages()] == [
            (5, 5, 0),
            (5, 2, 1),
        ]


def test_an_exception_still_leaves_a_whole_file(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / "bag") as bag:
        bag.write(bag.add_topic(CLOCK), b"\0\1\0\0" + bytes(8), log_time_ns=7)
        assert (tmp_path / "bag" / "bag_0.mcap.part").exists()
        with pytest.raises(BrokenRecording, match="cut short"):
            BagReader(tmp_path / "bag")
        raise ZeroDivisionError
    with BagReader(tmp_path / "bag") as reader:
        assert reader.message_count == 1
        reader.verify()
    assert bag.path == tmp_path / "bag" / "bag_0.mcap"


def test_chunks_are_closed_by_size_and_by_time(tmp_path: Path) -> None:
    counts = {}
    for name, chunk_bytes, period_s in (("size", 1000, 1e6), ("time", 10**9, 0.1), ("neither", 10**9, 1e6)):
        with BagWriter(tmp_path / name, chunk_bytes=chunk_bytes, chunk_period_s=period_s) as bag:
            topic = bag.add_topic(SCENE)
            for i in range(100):
                bag.write(topic, bytes(100), log_time_ns=i * 10**7)
        with (tmp_path / name / f"{name}_0.mcap").open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None and summary.statistics is not None
        counts[name] = len(summary.chunk_indexes)
        assert summary.statistics.message_count == 100
    # The first chunk holds schema and channel, more than 1000 bytes, and ends with its first message. A
    # message and its record head have 131 bytes, eight of them pass 1000: 1 + 99 / 8.
    assert counts == {"size": 14, "time": 10, "neither": 1}


KILLED = """
import sys
from pathlib import Path
from msgs_adapters.topics import CLOCK
from recordings.bag_writer import BagWriter
bag = BagWriter(Path(sys.argv[1]))
name = bag.add_topic(CLOCK)
for i in range(1000):
    bag.write(name, bytes((0, 1, 0, 0)) + i.to_bytes(8, "little"), log_time_ns=i * 1_000_000)
print("ready", flush=True)
sys.stdin.read()
"""


def test_a_killed_process_loses_no_more_than_one_chunk_period(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "bag")],
        cwd=root,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None and process.stdin is not None
    assert process.stdout.readline() == b"ready\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait(timeout=10)
    process.stdin.close()
    process.stdout.close()
    kept = 0
    with (tmp_path / "bag" / "bag_0.mcap.part").open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                kept += isinstance(record, Message)
        except EndOfFile:
            pass
    # 1 s in periods of 0.25 s: three are closed, the fourth was in memory.
    assert kept == 750
    with pytest.raises(BrokenRecording, match="cut short"):
        BagReader(tmp_path / "bag")
