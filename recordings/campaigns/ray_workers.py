"""Who runs the tests, on several machines: a Ray cluster, which runs those of a dead node again on another."""

import logging
import os
import secrets
import socket
import subprocess
import sys
from typing import Any
from urllib.parse import urlsplit

from config.errors import RefusedInput
from recordings.campaigns.one_test import Done, Task
from recordings.campaigns.workers import ONE_THREAD, TESTS_A_WORKER, TRIES, given_up

REACHED_S = 5.0
ANSWERED_S = 20.0
"""Ray itself asks a dead address for minutes."""
_PROBE = "import ray, sys; ray.init(address=sys.argv[1], logging_level='ERROR', log_to_driver=False)"
_NO_CODE = "failed to import on the worker"


class RayWorkers:
    """The processors of a Ray cluster, one for each test; nodes may die and join at any time.

    All nodes need pallet-twin in the versions that are here. One cluster at a time in a process.

    Args:
        address: of the head, as ``ray.init`` takes it: ``host:port`` on a machine that is one of the nodes,
            ``ray://host:port`` on another, or ``auto``. None starts a cluster of this machine alone, which
            listens on its loopback address.
        count: processors that a cluster of this machine has.

    Raises:
        RefusedInput: Ray is not installed, or nothing answers at the address.
    """

    def __init__(self, address: str | None = None, *, count: int = 1) -> None:
        self._address = address or "this machine"
        self._ray = _connected(address, count)
        self._run = self._ray.remote(
            num_cpus=1, max_calls=TESTS_A_WORKER, max_retries=TRIES - 1, retry_exceptions=True
        )(_run)
        self._tasks: dict[Any, Task] = {}

    @property
    def count(self) -> int:
        """See ``Workers``: the processors of all nodes that are alive; 1 while there is none, which waits for one."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    def submit(self, task: Task) -> None:
        """See ``Workers``."""
        self._tasks[self._run.remote(task, _versions())] = task

    def finished(self, timeout_s: float) -> list[Done]:
        """See ``Workers``.

        Raises:
            RefusedInput: a node has no pallet-twin, or other versions than this machine.
        """
        if not self._tasks:
            return []
        ready, _ = self._ray.wait(list(self._tasks), timeout=timeout_s)
        if ready:
            ready, _ = self._ray.wait(list(self._tasks), num_returns=len(self._tasks), timeout=0)
        return [self._taken(reference) for reference in ready]

    def close(self) -> None:
        """See ``Workers``. Ray ends what a driver that goes has begun."""
        self._tasks.clear()
        self._ray.shutdown()

    def _taken(self, reference: Any) -> Done:
        task = self._tasks.pop(reference)
        try:
            found: Done | str = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            told = str(error.cause).strip().split("\n")
            if _NO_CODE in told[0]:
                raise RefusedInput(
                    "--address", self._address, f"a node has no pallet-twin: {told[-1]}; install it there"
                ) from None
            return given_up(task, f"{type(error.cause).__name__}: {told[-1]}")
        except self._ray.exceptions.RayError as error:
            return given_up(task, str(error).split("\n")[0])
        if isinstance(found, str):
            raise RefusedInput("--address", self._address, found)
        return found


def _run(task: Task, wanted: dict[str, str]) -> Done | str:
    """Runs on a node: a test, or what the node has that would give other bytes."""
    from recordings.campaigns.one_test import prepare_worker, run_one

    there = _versions()
    other = [
        f"{name} {there.get(name)} instead of {value}"
        for name, value in wanted.items()
        if there.get(name) != value
    ]
    if other:
        return f"node {os.uname().nodename} has {', '.join(other)}; all nodes need the same"
    prepare_worker()
    return run_one(task)


def _versions() -> dict[str, str]:
    from sim_core.report import PICTURED, versions

    return versions(PICTURED)


def _connected(address: str | None, count: int) -> Any:
    """The module ``ray``, connected."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    # A dead node's last words would stand among what a command prints.
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")
    if address is None:
        # Ray's own switch for machines without a cluster, by which all its servers listen on loopback alone; and a
        # token that is not left in the user's home. All of it is read when Ray is imported.
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        os.environ.setdefault("RAY_AUTH_MODE", "token")
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    try:
        import ray
    except ModuleNotFoundError:
        raise RefusedInput(
            "--address",
            address or "this machine",
            "needs Ray, which is not installed: pip install 'pallet-twin[cluster]'",
        ) from None
    if address is None:
        where = {"address": "local", "num_cpus": count, "include_dashboard": False}
    else:
        _require_answer(address)
        where = {"address": address}
    try:
        ray.init(
            **where,
            runtime_env={"env_vars": ONE_THREAD},
            logging_level=logging.ERROR,
            log_to_driver=False,
        )
    except (RuntimeError, ConnectionError, ValueError, OSError) as error:
        raise _refused(address, str(error)) from None
    return ray


def _require_answer(address: str) -> None:
    """Tries the address in a process of its own, where it can be ended."""
    if address != "auto":
        parts = urlsplit(address if "://" in address else f"ray://{address}")
        try:
            socket.create_connection((parts.hostname or "", parts.port or 0), timeout=REACHED_S).close()
        except (OSError, ValueError) as error:
            raise _refused(address, str(error)) from None
    try:
        subprocess.run(
            [sys.executable, "-c", _PROBE, address],
            check=True, capture_output=True, text=True, timeout=ANSWERED_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise _refused(address, f"nothing that speaks Ray within {ANSWERED_S:.0f} s") from None
    except subprocess.CalledProcessError as error:
        raise _refused(address, error.stderr.strip().split("\n")[-1]) from None


def _refused(address: str | None, reason: str) -> RefusedInput:
    limit = f"no Ray cluster answers there: {reason.strip().split(chr(10))[0]}"
    return RefusedInput("--address", address or "this machine", limit)
