"""Climbs many scenes level by level, in this process or on several at once, and keeps each result as it comes."""

import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from os import _exit
from pathlib import Path

from config.errors import NodeDied, PalletTwinError, RefusedInput
from config.scene import Scene
from config.scene_file import scene_from_json
from sim_core.rating.levels import (
    LevelPlan,
    at_level,
    level_path,
    rated_level,
    refused_fields,
    stored_level,
)
from sim_core.report import Report, write_report

OnLevel = Callable[[int, int, str], None]
"""Called with the levels done, how many there may be in all at most, and the last one in words."""


@dataclass(frozen=True)
class Climbed:
    """What the climb of one scene came to.

    Attributes:
        scene: the resolved scene, at its own level.
        levels: the results that count, by level [g], from below.
        largest_g: the largest level that passed, or None.
        refused: why the test could not be run, or None.
    """

    scene: Scene
    levels: dict[float, Report]
    largest_g: float | None
    refused: RefusedInput | None = None

    @property
    def stopped_at_g(self) -> float | None:
        """The lowest level that did not pass [g], or None."""
        return next((level for level, report in self.levels.items() if report["verdict"] != "pass"), None)


class Climb:
    """One scene on its way up.

    Args:
        scene: a resolved scene.
        plan: its levels.
        folder: where results are kept.
    """

    def __init__(self, scene: Scene, plan: LevelPlan, folder: Path) -> None:
        self.scene, self.plan = scene, plan
        self.refused: RefusedInput | None = None
        self._folder = folder
        self._reports: dict[int, Report] = {}
        self._paths: dict[int, Path] = {}
        self._sought: set[int] = set()

    def path(self, level: int) -> Path:
        """Where a level's result is kept."""
        if level not in self._paths:
            self._paths[level] = level_path(self._folder, self.at(level))
        return self._paths[level]

    def at(self, level: int) -> Scene:
        """The scene at a level."""
        return at_level(self.scene, self.plan.level_g(level))

    def wanted(self) -> list[int]:
        """Levels still needed, the most needed first; where that one is on disk already it is taken from there."""
        while self.refused is None:
            needed = self.plan.walk(self._verdicts())[1]
            if not needed or needed[0] in self._sought:
                return needed
            try:
                found = stored_level(self.path(needed[0]))
            except RefusedInput as error:
                self.refused = error
                break
            self._sought.add(needed[0])
            if found is not None:
                self._reports[needed[0]] = found
        return []

    def take(self, level: int, result: Report) -> None:
        """Takes a result."""
        if "refused" in result:
            self.refused = RefusedInput(**result["refused"])
        else:
            self._reports[level] = result

    @property
    def result(self) -> Climbed:
        """What it came to so far."""
        verdicts = self._verdicts()
        met = sorted(self.plan.walk(verdicts)[0])
        largest = self.plan.largest(verdicts)
        return Climbed(
            self.scene,
            {self.plan.level_g(level): self._reports[level] for level in met},
            None if largest is None else self.plan.level_g(largest),
            self.refused,
        )

    def _verdicts(self) -> dict[int, str]:
        return {level: report["verdict"] for level, report in self._reports.items()}


def climb_all(
    scenes: Sequence[Scene],
    plan: LevelPlan,
    folder: Path,
    *,
    workers: int = 1,
    on_level: OnLevel | None = None,
) -> list[Climbed]:
    """Climbs every scene until a level does not pass.

    Each result is written as soon as it is there, by the process that has it, and taken from there the next time. With
    more workers than scenes, the idle ones try higher levels ahead of the climb.

    Args:
        scenes: resolved scenes.
        plan: their levels.
        folder: where results are kept; made where it is missing.
        workers: processes; 1 is this one alone.
        on_level: called after every level.

    Raises:
        NodeDied: a worker was killed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    climbs = [Climb(scene, plan, folder) for scene in scenes]
    if workers == 1:
        for climb in climbs:
            while wanted := climb.wanted():
                climb.take(wanted[0], _run_level(climb.at(wanted[0]).to_json(), climb.path(wanted[0])))
                _tell(climbs, on_level, climb, wanted[0])
    elif any(climb.wanted() for climb in climbs):
        _climb_together(climbs, workers, on_level)
    return [climb.result for climb in climbs]


def _climb_together(climbs: Sequence[Climb], workers: int, on_level: OnLevel | None) -> None:
    # Spawned, not forked: a fork would share this process's threads and physics server.
    context = get_context("spawn")
    stop, stopped = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with, initargs=(stop,))
    running: dict[Path, Future[Report]] = {}
    try:
        while waiting := _most_needed(climbs):
            for climb, level in waiting:
                path = climb.path(level)
                if path not in running and len(running) < workers:
                    running[path] = pool.submit(_run_level, climb.at(level).to_json(), path)
            done, _ = wait(running.values(), return_when=FIRST_COMPLETED)
            for path in [path for path, future in running.items() if future in done]:
                report = running.pop(path).result()
                for climb, level in [entry for entry in waiting if entry[0].path(entry[1]) == path]:
                    climb.take(level, report)
                    _tell(climbs, on_level, climb, level)
    except BrokenProcessPool:
        raise NodeDied(
            "a worker",
            "was killed, or the memory is full; the same command goes on from here, fewer --workers help",
        ) from None
    finally:
        # What is still under way is not needed, or this process was interrupted: nothing that is done is lost.
        stopped.close()
        stop.close()
        pool.shutdown(wait=False, cancel_futures=True)


def _most_needed(climbs: Sequence[Climb]) -> list[tuple[Climb, int]]:
    """What may be run next: first what each climb needs now, then what it needs should that pass, and so on."""
    ranked = [
        (rank, number, climb, level)
        for number, climb in enumerate(climbs)
        for rank, level in enumerate(climb.wanted())
    ]
    return [(climb, level) for _, _, climb, level in sorted(ranked, key=lambda entry: entry[:2])]


def _tell(climbs: Sequence[Climb], on_level: OnLevel | None, climb: Climb, level: int) -> None:
    if on_level is None:
        return
    results = [climb.result for climb in climbs]
    done = sum(len(result.levels) for result in results)
    left = sum(len(climb.wanted()) for climb in climbs)
    found = climb.result.levels.get(climb.plan.level_g(level))
    words = "" if found is None else f"{climb.plan.level_g(level):g} g {found['verdict']}"
    on_level(done, done + left, words)


def _end_with(stop: Connection) -> None:
    """Makes a worker end at once when the process in front closes its end of the pipe, or is killed."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN if number == signal.SIGINT else signal.SIG_DFL)

    def watch() -> None:
        try:
            stop.recv()
        except (EOFError, OSError):
            _exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _run_level(scene_json: str, path: Path) -> Report:
    """Runs one level and keeps its result; a refusal is sent back in words, for it is no result."""
    found = stored_level(path)
    if found is not None:
        return found
    try:
        report = rated_level(scene_from_json(scene_json))
    except RefusedInput as error:
        return {"refused": refused_fields(error)}
    except PalletTwinError as error:
        return {"refused": {"field": "scene", "value": path.name, "limit": str(error)}}
    write_report(report, path)
    return stored_level(path) or report
