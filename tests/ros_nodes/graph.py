"""Runs the command line as real processes, each graph on a ROS domain of its own."""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from recordings.bag_reader import BagReader

_numbers = itertools.count()

HEAVY_ON_LIGHT = {
    "name": "heavy-on-light",
    "load": {
        "packages": [
            {"id": "light", "size_m": [0.4, 0.4, 0.2], "mass_kg": 0.5, "position_m": [0, 0, 0.1]},
            {"id": "heavy", "size_m": [0.4, 0.4, 0.2], "mass_kg": 2000, "position_m": [0, 0, 0.3]},
        ]
    },
    "pallet": None,
    "sled": {"profile": "eumos", "level_g": 0.3},
}
"""A scene that Bullet cannot do right, so that a monitor must end it."""


def fresh_domain() -> str:
    """A domain that no other worker of this run uses, and this one long ago; Linux' ephemeral ports leave 0 to 101."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    share = max(1, 96 // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))
    return str(5 + (worker * share + next(_numbers) % share) % 96)


def environment() -> dict[str, str]:
    """This process' environment with a fresh domain."""
    return {**os.environ, "ROS_DOMAIN_ID": fresh_domain()}


def pallet_twin(
    *arguments: str, cwd: Path, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Runs a command to its end."""
    return subprocess.run(
        [sys.executable, "-m", "ros_nodes.cli", *arguments],
        cwd=cwd,
        env=env or environment(),
        capture_output=True,
        text=True,
        timeout=180,
    )


def start(*arguments: str, cwd: Path, env: dict[str, str]) -> subprocess.Popen[str]:
    """Starts a command."""
    return subprocess.Popen(
        [sys.executable, "-m", "ros_nodes.cli", *arguments],
        cwd=cwd,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def node_pids(parent: int) -> dict[str, int]:
    """Process ids of a supervisor's nodes by name, as the kernel lists them."""
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            status = (entry / "stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(status[1]) == parent and status[0] != "Z":
            for word in words:
                if word.startswith(b"ros_nodes.") and word.endswith(b"_node"):
                    found[word.decode().removeprefix("ros_nodes.")] = int(entry.name)
    return found


def wait_until_recording(bag: Path, *, more_than: int = 80_000) -> None:
    """Waits until the recorder has put some chunks on disk."""
    deadline = time.monotonic() + 60.0
    while sum(part.stat().st_size for part in bag.glob("*.part")) <= more_than:
        assert time.monotonic() < deadline, "nothing was recorded"
        time.sleep(0.02)


def kill(pid: int) -> None:
    """Kills a process at once."""
    os.kill(pid, signal.SIGKILL)


def payloads(bag: Path, topic: str) -> list[bytes]:
    """A topic's messages."""
    with BagReader(bag) as reader:
        return [message.payload for message in reader.messages([topic])]


def counts(bag: Path) -> dict[str, int]:
    """Messages by topic."""
    with BagReader(bag) as reader:
        return {name: topic.message_count for name, topic in reader.topics.items()}


def missing_of(bag: Path) -> Iterator[str]:
    """Topics that a recorder found holes in."""
    with BagReader(bag) as reader:
        for name in reader.metadata_names:
            yield from (key for key in reader.metadata(name) if key.startswith("missing"))
