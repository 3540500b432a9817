"""Who runs the tests: processes of this machine, each known by its pipe, so that a dead one takes one test with it."""

import os
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Protocol

from recordings.campaigns.one_test import Done, Task, run_one

TRIES = 3
"""A test whose worker dies so many times is given up."""
GIVEN_UP = "given up"
"""What the reason of such a test begins with."""
TESTS_A_WORKER = 60
"""Then a fresh process takes over, so that nothing that a library keeps can pile up."""
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA", "LP")}
"""Tests run side by side: threads of one would only take another's core."""


class Workers(Protocol):
    """Something that runs tests, several at a time."""

    @property
    def count(self) -> int:
        """How many tests can run at a time."""

    def submit(self, task: Task) -> None:
        """Hands out a test; no more than ``count`` at a time."""

    def finished(self, timeout_s: float) -> list[Done]:
        """Tests that came to an end since it was asked last; waits for one, at most so long [s]."""

    def close(self) -> None:
        """Ends all workers at once; tests on the way are lost."""


@dataclass
class _Worker:
    process: "object"
    pipe: Connection
    task: Task | None = None
    tests: int = 0


class ProcessWorkers:
    """Worker processes on this machine.

    Args:
        count: how many.
    """

    def __init__(self, count: int) -> None:
        self._context = get_context("spawn")
        os.environ.update(ONE_THREAD)
        self._tries: dict[int, int] = {}
        self._given_up: deque[Done] = deque()
        self._workers = [self._new() for _ in range(count)]

    @property
    def count(self) -> int:
        """See ``Workers``."""
        return len(self._workers)

    def submit(self, task: Task) -> None:
        """See ``Workers``."""
        place = next(k for k, worker in enumerate(self._workers) if worker.task is None)
        if self._workers[place].tests == TESTS_A_WORKER:
            self._end(self._workers[place])
            self._workers[place] = self._new()
        worker = self._workers[place]
        worker.task, worker.tests = task, worker.tests + 1
        # One that died while it was idle says so when it is asked for results.
        with suppress(OSError):
            worker.pipe.send(task)

    def finished(self, timeout_s: float) -> list[Done]:
        """See ``Workers``."""
        busy = {worker.pipe: place for place, worker in enumerate(self._workers) if worker.task is not None}
        found = [self._given_up.popleft() for _ in range(len(self._given_up))]
        for pipe in wait(list(busy), 0.0 if found else timeout_s):
            place = busy[pipe]  # type: ignore[index]
            worker = self._workers[place]
            try:
                found.append(worker.pipe.recv())
                worker.task = None
            except (EOFError, OSError):
                self._replace(place)
        return found

    def close(self) -> None:
        """See ``Workers``."""
        for worker in self._workers:
            worker.process.kill()  # type: ignore[attr-defined]
        for worker in self._workers:
            worker.process.join()  # type: ignore[attr-defined]
            worker.pipe.close()

    @property
    def processes(self) -> list[int]:
        """Process numbers of the workers."""
        return [worker.process.pid for worker in self._workers]  # type: ignore[attr-defined]

    def _replace(self, place: int) -> None:
        """A new worker takes over the test of a dead one, unless that test has outlived too many."""
        dead = self._workers[place]
        task = dead.task
        assert task is not None
        dead.process.join()  # type: ignore[attr-defined]
        dead.pipe.close()
        self._workers[place] = self._new()
        self._tries[task.number] = self._tries.get(task.number, 0) + 1
        if self._tries[task.number] < TRIES:
            self.submit(task)
            return
        code = dead.process.exitcode  # type: ignore[attr-defined]
        self._given_up.append(given_up(task, f"its process ended with code {code}"))

    def _end(self, worker: _Worker) -> None:
        worker.pipe.close()
        worker.process.join()  # type: ignore[attr-defined]

    def _new(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_work, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)


def given_up(task: Task, why: str) -> Done:
    """A test that no worker brought to an end."""
    return Done(task.number, None, None, {}, f"{GIVEN_UP} after {TRIES} tries: {why}")


def _work(pipe: Connection) -> None:
    from recordings.campaigns.one_test import prepare_worker

    prepare_worker()
    threading.Thread(target=_end_with_the_driver, daemon=True).start()
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        done = run_one(task)
        try:
            pipe.send(done)
        except OSError:
            return


def _end_with_the_driver() -> None:
    driver = parent_process()
    if driver is not None:
        driver.join()
        os._exit(1)
