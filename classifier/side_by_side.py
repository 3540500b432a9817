"""Work on many bags in processes of this machine, a result at a time."""

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from config.errors import RefusedInput
from recordings.campaigns.one_test import prepare_worker
from recordings.campaigns.workers import ONE_THREAD

T = TypeVar("T")
R = TypeVar("R")


def side_by_side(work: Callable[[T], R], tasks: Mapping[str, T], workers: int) -> Iterator[tuple[str, R]]:
    """Results with the keys of their tasks, as they are done.

    Args:
        work: what is done with each; it has to be known by a name of its module.
        tasks: by key.
        workers: processes; with one, or one task, it is done in this process.

    Raises:
        RefusedInput: a process was killed.
    """
    if workers <= 1 or len(tasks) <= 1:
        yield from ((key, work(task)) for key, task in tasks.items())
        return
    os.environ.update(ONE_THREAD)
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=prepare_worker)
    try:
        running = {pool.submit(work, task): key for key, task in tasks.items()}
        for done in as_completed(running):
            yield running[done], done.result()
    except BrokenProcessPool:
        limit = "one was killed, for lack of memory for instance; the same command goes on"
        raise RefusedInput("workers", workers, limit) from None
    finally:
        pool.shutdown(cancel_futures=True)
