"""A Ray cluster makes what processes make, also when one of its nodes dies; what is no cluster is refused."""

import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from config.errors import RefusedInput
from recordings.campaigns import ray_workers
from recordings.campaigns.driver import Standing
from recordings.campaigns.one_test import run_one
from recordings.campaigns.ray_workers import RayWorkers
from recordings.campaigns.store import read_labels
from tests.recordings.tiny_campaign import digest_on_disk, finished, run, tasks, tiny, wait_until

TESTS = 8
WITHOUT_RAY = """
import sys
sys.modules["ray"] = None
from recordings.campaigns.ray_workers import RayWorkers
try:
    RayWorkers()
except Exception as error:
    print(error)
"""


@pytest.fixture
def cluster() -> Iterator[Any]:
    """One node with one processor, on the loopback address."""
    # Not pytest's folder: sockets have short names.
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory(prefix="ray-") as scratch:
        # Read when Ray is imported; the first two are what RayWorkers sets for a cluster of this machine.
        patch.setenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        patch.setenv("RAY_DEDUP_LOGS_SKIP_REGEX", ".")
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        from ray.cluster_utils import Cluster

        head = {"num_cpus": 1, "include_dashboard": False, "temp_dir": scratch}
        nodes = Cluster(initialize_head=True, head_node_args=head)
        yield nodes
        nodes.shutdown()


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_cluster_makes_the_same_and_outlives_a_node(
    cluster: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    campaign, out, dead = tiny(tests=TESTS), tmp_path / "ray", []
    workers = RayWorkers(cluster.address)
    assert workers.count == 1
    mortal = cluster.add_node(num_cpus=1)
    wait_until(lambda: workers.count == 2, "the second node")

    def kill_a_node(standing: Standing) -> None:
        # One test is on its way on each node.
        if standing.done >= 2 and standing.running == 2 and not dead:
            cluster.remove_node(mortal, allow_graceful=False)
            dead.append(mortal)

    standing = run(out, workers, campaign, on_progress=kill_a_node)
    assert dead
    assert (standing.done, standing.new, standing.refused) == (TESTS, TESTS, 0)
    assert finished(out) == list(range(TESTS))
    for task, label in zip(tasks(campaign, TESTS), read_labels(out), strict=True):
        assert run_one(task).label == label
        assert digest_on_disk(out, label.number) == label.bag_sha256
    assert "raylet" not in "".join(capfd.readouterr())


def test_what_is_no_cluster_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_workers, "ANSWERED_S", 3.0)
    began = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        port = deaf.getsockname()[1]
        with pytest.raises(RefusedInput, match="nothing that speaks Ray within 3 s"):
            RayWorkers(f"127.0.0.1:{port}")
    for address in (f"127.0.0.1:{port}", "nowhere.invalid:6379", "6379", "ray://", "127.0.0.1:99999"):
        with pytest.raises(RefusedInput, match=f"--address = {address}: no Ray cluster") as refused:
            RayWorkers(address)
        assert "\n" not in str(refused.value)
    assert time.monotonic() - began < 30.0


def test_missing_ray_is_said_in_one_line() -> None:
    answer = subprocess.run([sys.executable, "-c", WITHOUT_RAY], capture_output=True, text=True, check=True)
    assert answer.stdout == (
        "--address = this machine: needs Ray, which is not installed: pip install 'pallet-twin[cluster]'\n"
    )
