"""A recorder that is killed with SIGKILL at a random moment, and what is missing from its bag afterwards.

``python -m tests.recordings.killed_recorder [COUNT] [SEED]`` prints one line a kill.
"""

import mmap
import random
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from config.scene_file import find_scene, read_scene
from msgs_adapters.cdr import serialize
from msgs_adapters.convert import to_imu, to_odometry, to_string
from msgs_adapters.publications import frame_publication
from msgs_adapters.topics import CLOCK, PACKAGES_POSES, SCENE, SLED_ACCELEROMETER, SLED_ODOMETRY
from recordings.bag_reader import BagReader
from recordings.graph_recorder import GraphRecorder
from recordings.rescue import Recovery, recover_bag
from sim_core.frames import AccelerometerSample, PoseFrame, SledSample

EPOCH_NS = 10**12
RATES_HZ = {SLED_ACCELEROMETER: 1000, CLOCK: 240, PACKAGES_POSES: 240, SLED_ODOMETRY: 240}
_STAMP, _TAKEN = struct.Struct("<iI"), struct.Struct("<q")


@dataclass(frozen=True)
class Killed:
    """One kill: its bag, when it fell, the stamp that was taken last [ns], and what could be recovered."""

    bag: Path
    after_s: float
    taken_ns: int
    recovery: Recovery

    @property
    def lost_s(self) -> float:
        """What is missing at the end."""
        return (self.taken_ns - max(self.recovery.end_ns, EPOCH_NS)) * 1e-9


def kill_recorder(folder: Path, *, count: int, seed: int, longest_s: float = 2.0) -> list[Killed]:
    """Starts a recorder ``count`` times, kills each at a random moment, and recovers what it left."""
    random_, kills = random.Random(seed), []
    for number in range(count):
        after_s, bag, taken = (
            random_.uniform(0.0, longest_s),
            folder / f"bag{number}",
            folder / f"taken{number}",
        )
        taken.write_bytes(bytes(_TAKEN.size))
        command = [sys.executable, "-m", "tests.recordings.killed_recorder", "record", str(bag), str(taken)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[2]) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"recording\n"
            time.sleep(after_s)
            process.kill()
        (taken_ns,) = _TAKEN.unpack(taken.read_bytes())
        kills.append(Killed(bag, after_s, taken_ns, recover_bag(bag)))
    return kills


def holes(bag: Path) -> dict[str, int]:
    """How many messages are missing between a topic's first and its last, by topic."""
    found = {}
    with BagReader(bag) as reader:
        reader.verify()
        for topic, rate_hz in RATES_HZ.items():
            name = topic.absolute_name()
            stamps = (
                [message.publish_time_ns for message in reader.messages([name])]
                if name in reader.topics
                else []
            )
            if stamps:
                found[name] = round((stamps[-1] - stamps[0]) * rate_hz / 1e9) + 1 - len(stamps)
    return found


def record(bag: Path, taken: Path) -> None:
    """Records a bench's streams at their rates until the process is killed."""
    scene = read_scene(find_scene("block_slip"), [])
    count = len(scene.packages) + 1
    frame = PoseFrame(0, EPOCH_NS, np.zeros((count, 3)), np.tile([0.0, 0, 0, 1], (count, 1)))
    zero = np.zeros(3)
    payloads = {
        SLED_ACCELEROMETER: serialize(to_imu(AccelerometerSample(EPOCH_NS, zero, 1e-4))),
        CLOCK: bytes((0, 1, 0, 0)) + bytes(8),
        PACKAGES_POSES: frame_publication(frame).payload,
        SLED_ODOMETRY: serialize(to_odometry(SledSample(0, EPOCH_NS, 1 / 240, zero, zero, zero))),
    }
    sent = dict.fromkeys(RATES_HZ, 0)
    recorder = GraphRecorder(bag, [SCENE, *RATES_HZ])
    with taken.open("r+b") as stream, mmap.mmap(stream.fileno(), _TAKEN.size) as shared:
        recorder.take(SCENE, serialize(to_string(scene.to_json())))
        sys.stdout.write("recording\n")
        sys.stdout.flush()
        began = time.monotonic()
        while time.monotonic() - began < 30.0:
            now_s = time.monotonic() - began
            for topic, rate_hz in RATES_HZ.items():
                while sent[topic] / rate_hz <= now_s:
                    stamp_ns = EPOCH_NS + sent[topic] * 10**9 // rate_hz
                    stamp = _STAMP.pack(*divmod(stamp_ns, 10**9))
                    recorder.take(topic, payloads[topic][:4] + stamp + payloads[topic][12:])
                    sent[topic] += 1
                    shared[:] = _TAKEN.pack(stamp_ns)
            time.sleep(0.001)


def main(arguments: list[str]) -> None:
    if arguments[:1] == ["record"]:
        record(Path(arguments[1]), Path(arguments[2]))
        return
    count, seed = (int(text) for text in (arguments + ["50", "1"][len(arguments) :]))
    with tempfile.TemporaryDirectory() as folder:
        kills = kill_recorder(Path(folder), count=count, seed=seed)
        lines = [
            f"killed after {kill.after_s:.3f} s: {kill.recovery.message_count} messages, "
            f"{kill.lost_s:.3f} s lost, holes {sum(holes(kill.bag).values())}\n"
            for kill in kills
        ]
        lines.append(f"{len(kills)} kills: at most {max(kill.lost_s for kill in kills):.3f} s lost\n")
        sys.stdout.writelines(lines)


if __name__ == "__main__":
    main(sys.argv[1:])
