"""What was written is read; what is damaged, cut short or foreign is refused in one line."""

import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.errors import BrokenRecording, RefusedInput
from msgs_adapters import convert
from msgs_adapters.pose_payloads import pose_frame_from_payload
from msgs_adapters.topics import ALL_TOPICS, SCENE
from recordings.bag_reader import BagReader
from recordings.bag_writer import BagWriter
from recordings.schemas import message_definition

Records = list[tuple[str, bytes, int]]


def test_everything_written_is_read(sample_bag: Path, sample_records: Records) -> None:
    for path in (sample_bag, sample_bag / "sample_0.mcap"):
        with BagReader(path) as bag:
            read = [(m.topic_name, m.payload, m.log_time_ns) for m in bag.messages()]
            assert read == sample_records
            assert bag.message_count == len(sample_records)
            assert (bag.start_ns, bag.end_ns) == (sample_records[0][2], sample_records[-1][2])
            assert [recorded.topic for recorded in bag.topics.values()] == [
                topic.in_namespace() for topic in ALL_TOPICS
            ]
            for recorded in bag.topics.values():
                assert recorded.type_hash == message_definition(recorded.topic.type_name).type_hash
            assert bag.attachment_names == ["scene.json", "report.json"]
            assert bag.attachment("report.json") == b'{"verdict": "pass"}'
            assert bag.metadata("pallet_twin") == {"version": "0", "gaps": "0"}
            assert bag.metadata_names == ["pallet_twin", "rosbag2"]
            bag.verify()


def test_selection_by_topic_and_time(sample_bag: Path, sample_records: Records) -> None:
    names = {"/twin/packages/poses", "/clock"}
    start_ns, end_ns = sample_records[100][2], sample_records[400][2]
    expected = [r for r in sample_records if r[0] in names and start_ns <= r[2] < end_ns]
    with BagReader(sample_bag) as bag:
        messages = bag.messages(names, start_ns=start_ns, end_ns=end_ns)
        assert [(m.topic_name, m.payload, m.log_time_ns) for m in messages] == expected
        for absent in ("/nope", "packages/poses"):
            with pytest.raises(BrokenRecording, match="it has: /clock"):
                bag.messages([absent])
        with pytest.raises(BrokenRecording, match=r"it has: scene\.json"):
            bag.attachment("nope")
        with pytest.raises(BrokenRecording, match="it has: pallet_twin"):
            bag.metadata("nope")


def test_messages_decode(sample_bag: Path) -> None:
    with BagReader(sample_bag) as bag:
        decoded = {m.topic_name: m.decode() for m in bag.messages() if m.topic_name != "/tf"}
        assert decoded["/twin/scene"].data == '{"name": "two"}'
        assert convert.rule_states(decoded["/twin/eumos/status"])[0].margin_mm == 38.5
        assert convert.progress_of(decoded["/twin/physics/progress"]).frames == 60
        *_, last = bag.messages(["/twin/packages/poses"])
        assert pose_frame_from_payload(last.payload, 59).positions[2, 0] == pytest.approx(0.059, abs=1e-15)
        with pytest.raises(RefusedInput, match="is not installed"):
            next(bag.messages(["/tf"])).decode()


def test_a_payload_that_is_no_message_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(writer.add_topic(SCENE), b"\0\1\0\0\xff\xff\xff\x7fx", log_time_ns=1)
    with (
        BagReader(tmp_path / "bag") as bag,
        pytest.raises(BrokenRecording, match="is no std_msgs"),
    ):
        next(bag.messages()).decode()


def read_all(path: Path) -> list[bytes]:
    """Everything that a caller can see of a bag, whole file verified."""
    with BagReader(path) as bag:
        bag.verify()
        return [
            *(message.payload for message in bag.messages()),
            *(bag.attachment(name) for name in bag.attachment_names),
            *(str(bag.metadata(name)).encode() for name in bag.metadata_names),
        ]


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_file_cut_anywhere_is_said_to_be_cut_short(
    tmp_path_factory: pytest.TempPathFactory, sample_bag: Path, data: st.DataObject
) -> None:
    content = (sample_bag / "sample_0.mcap").read_bytes()
    length = data.draw(st.integers(1, len(content) - 1))
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(content[:length])
    with pytest.raises(BrokenRecording, match="was cut short"):
        BagReader(path)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_flipped_bit_is_found(
    tmp_path_factory: pytest.TempPathFactory, sample_bag: Path, data: st.DataObject
) -> None:
    content = bytearray((sample_bag / "sample_0.mcap").read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.getbasetemp() / "flipped.mcap"
    path.write_bytes(content)
    with pytest.raises(BrokenRecording) as caught:
        read_all(path)
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_without_verify_a_flipped_bit_never_changes_a_message(
    tmp_path_factory: pytest.TempPathFactory, sample_bag: Path, data: st.DataObject
) -> None:
    whole = (sample_bag / "sample_0.mcap").read_bytes()
    content = bytearray(whole)
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.getbasetemp() / "flipped.mcap"
    path.write_bytes(content)
    with BagReader(sample_bag) as bag:
        expected = list(bag.messages())
    try:
        with BagReader(path) as bag:
            assert list(bag.messages()) == expected
            assert bag.attachment("report.json") == b'{"verdict": "pass"}'
    except BrokenRecording:
        pass


@pytest.mark.parametrize(
    ("content", "limit"),
    [(b"", "is empty"), (b"not a bag at all", "is not an MCAP file"), (b"\x89MCAP", "was cut short")],
)
def test_files_that_are_no_recording(tmp_path: Path, content: bytes, limit: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    for opened in (path, tmp_path):
        with pytest.raises(BrokenRecording, match=limit):
            BagReader(opened)


def test_directories_that_are_no_recording(tmp_path: Path, mcap_bytes: bytes) -> None:
    with pytest.raises(BrokenRecording, match="does not exist"):
        BagReader(tmp_path / "nope")
    with pytest.raises(BrokenRecording, match="is no recording"):
        BagReader(tmp_path)
    part = tmp_path / "x_0.mcap.part"
    part.write_bytes(mcap_bytes)
    for opened in (part, tmp_path):
        with pytest.raises(BrokenRecording, match="was cut short: its writer"):
            BagReader(opened)
    # A directory that lost its metadata.yaml alone can still be read.
    part.rename(tmp_path / "x_0.mcap")
    with BagReader(tmp_path) as bag:
        assert bag.message_count > 0


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("", "is not the metadata"),
        ("{", "is not the metadata"),
        ("- 1", "is not the metadata"),
        ("{rosbag2_bagfile_information: {storage_identifier: sqlite3, relative_file_paths: [x]}}", "'mcap'"),
        ("{rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: []}}", "one file"),
        ("{rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [/x]}}", "a path"),
        ("{rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [..]}}", "a path"),
        ("{rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [x]}}", "not exist"),
    ],
)
def test_metadata_that_is_wrong(tmp_path: Path, text: str, limit: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(BrokenRecording, match=limit):
        BagReader(tmp_path)


def test_memory_is_bounded_by_chunks_not_by_the_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", chunk_bytes=100_000) as writer:
        topic = writer.add_topic(SCENE)
        for i in range(400):
            writer.write(topic, bytes(50_000), log_time_ns=i * 10**6)
    with BagReader(tmp_path / "bag") as bag:
        tracemalloc.start()
        total = sum(len(message.payload) for message in bag.messages())
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert total == 20_000_000
    # A chunk of three messages, decompressed, split into records and handed out: a few times 150 kB.
    assert peak < 2_000_000
