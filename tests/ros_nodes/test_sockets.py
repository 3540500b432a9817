"""Nothing of a twin can be reached from another host, nor from another ROS domain."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.ros_nodes.graph import environment, fresh_domain, pallet_twin, start
from tests.ros_nodes.sockets import LOOPBACK, listening, receiving

LOOK = """
import time, rclpy
rclpy.init()
node = rclpy.create_node("looker")
until, seen = time.monotonic() + float({seconds}), set()
while time.monotonic() < until:
    rclpy.spin_once(node, timeout_sec=0.1)
    seen |= {{name for name, _ in node.get_topic_names_and_types() if name.startswith("/twin")}}
print(len(seen))
"""


def sockets_while_it_runs(pid: int, domain: int, *, until: float) -> tuple[set[str], set[str]]:
    """All addresses that messages and connections are taken on, looked at again and again."""
    udp: set[str] = set()
    tcp: set[str] = set()
    while time.monotonic() < until:
        try:
            udp |= receiving(pid, domain)
            tcp |= listening(pid)
        except OSError:
            # A process that has just ended.
            continue
        time.sleep(0.1)
    return udp, tcp


def topics_seen(env: dict[str, str], seconds: float) -> int:
    done = subprocess.run(
        [sys.executable, "-c", LOOK.format(seconds=seconds)],
        env=env,
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout)


@pytest.fixture
def local() -> dict[str, str]:
    env = {**environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    env.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    return env


def test_graph_takes_messages_on_the_loopback_alone(tmp_path: Path, local: dict[str, str]) -> None:
    camera = {"width_px": 160, "height_px": 90, "rate_hz": 15}
    arguments = [
        "--set",
        f"camera={json.dumps(camera)}",
        "--set",
        "sled.lead_s=6",
        "--pace",
        "real",
        "--no-estimate",
    ]
    graph = start("up", "block_slip", *arguments, "--out", "o", cwd=tmp_path, env=local)
    try:
        # The other domain looks while the twin runs; its own domain does see it.
        time.sleep(5.0)
        other = {**local, "ROS_DOMAIN_ID": fresh_domain()}
        assert topics_seen(other, 2.0) == 0
        assert topics_seen(local, 2.0) > 5
        udp, tcp = sockets_while_it_runs(graph.pid, int(local["ROS_DOMAIN_ID"]), until=time.monotonic() + 1.5)
    finally:
        graph.send_signal(signal.SIGINT)
        graph.communicate(timeout=60)
    assert udp == {LOOPBACK}
    assert tcp == set()


def test_player_takes_messages_on_the_loopback_alone(tmp_path: Path, local: dict[str, str]) -> None:
    assert (
        pallet_twin("run", "block_slip", "--no-estimate", "--no-page", "--out", "o", cwd=tmp_path).returncode
        == 0
    )
    player = start("replay", "o/bag", "--paused", cwd=tmp_path, env=local)
    try:
        udp, tcp = sockets_while_it_runs(
            player.pid, int(local["ROS_DOMAIN_ID"]), until=time.monotonic() + 7.0
        )
    finally:
        player.send_signal(signal.SIGINT)
        player.communicate(timeout=60)
    assert udp == {LOOPBACK}
    assert tcp == set()
