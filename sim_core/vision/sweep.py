"""The measurement over many simulated loads: how far off it is, whether it knows, and whether its verdict is right."""

import csv
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np

from config.camera import Camera, Markers
from config.scene import EumosSled, ForceFields, Scene
from config.scene_file import find_scene, overridden, read_scene
from sim_core.report import PICTURED, versions
from sim_core.vision.trial import Trial, picture_trial
from sim_core.work_precision import with_setting

FORMAT = 2
"""Version of the rows on disk; raise it when a row's fields or their meaning change."""
LEVELS_G = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
SEED = 20_260
SCENES_A_LOOK = 30
FILM_SCENES = 12
BARE_LOADS = ("eur_columns", "eur_interlocked", "mixed_sizes", "stackbuilder", "pally")
FILM_LOADS = ("eur_wrap_lldpe", "mixed_wrap", "eur_wrap_one_way")

Look = Literal["markers", "bare", "film"]
LOOKS: tuple[Look, ...] = ("markers", "bare", "film")
BARS_MM: dict[Look, float] = {"markers": 1.5, "bare": 3.0, "film": 5.0}
"""What the root mean square error of one test may be, a look [mm]."""
DEVIATION_EDGES = np.linspace(-5.0, 5.0, 41)
"""Between these an error divided by its stated uncertainty is counted; beyond the ends, in two bins more."""
Progress = Callable[[int, int, object], None]
Case = tuple[str, Look, Scene]
"""A test's name, its look and its scene, whose sled goes by the EUMOS profile."""


@dataclass(frozen=True)
class SightRow:
    """One load, drawn and measured.

    Attributes:
        key: digest of all that the row depends on; a row on disk with this key is not run again.
        name: load, level and frictions.
        look: with markers, without, or behind film.
        level_g: of the sled [g].
        rms_mm: root mean square error of a component [mm].
        largest_mm: largest error of a component [mm].
        coverage: share of errors inside the 95 % that is stated.
        errors: number of components compared.
        deviations: how many of them, divided by their standard uncertainty, lie below, between and above
            ``DEVIATION_EDGES``; 42 counts.
        tracked: share of the displacements that were measured.
        verdict: by the pictures.
        judged: by the poses, rules (i) to (iii).
        agrees: whether a verdict other than ``unresolved`` is the judge's.
        missed: rules, separated by spaces, whose state is neither the judge's nor ``unresolved``.
        unsettled: rules, separated by spaces, whose state is ``unresolved``.
        take_ms: median time that a picture takes to measure [ms].
        slowest_ms: 95th percentile of it [ms].
    """

    key: str
    name: str
    look: Look
    level_g: float
    rms_mm: float
    largest_mm: float
    coverage: float
    errors: int
    deviations: tuple[int, ...]
    tracked: float
    verdict: str
    judged: str
    agrees: bool
    missed: str
    unsettled: str
    take_ms: float
    slowest_ms: float


@dataclass(frozen=True)
class SightSummary:
    """All rows of one look together.

    Attributes:
        look: which.
        scenes: how many.
        rms_mm: root mean square error over all components of all scenes [mm].
        worst_rms_mm: of the worst scene [mm].
        coverage: share of all errors inside the 95 % that is stated.
        same: verdicts that are the judge's.
        open: verdicts that are ``unresolved``.
        other: verdicts that are neither.
        take_ms: median over the scenes of the median time a picture [ms].
    """

    look: Look
    scenes: int
    rms_mm: float
    worst_rms_mm: float
    coverage: float
    same: int
    open: int
    other: int
    take_ms: float


def run_sight(
    out: Path,
    *,
    quick: bool = False,
    cases: Sequence[Case] | None = None,
    workers: int = 1,
    on_progress: Progress | None = None,
) -> tuple[list[SightRow], list[SightSummary]]:
    """Measures every load of the sweep and writes ``sight.csv`` and ``sight.json``.

    Rows that the folder already holds are not run again.

    Args:
        out: folder, made where it is missing.
        quick: two loads a look.
        cases: other tests than the sweep's.
        workers: tests at once; more than there are free cores make the times of measuring longer.
        on_progress: called with rows done, how many there are, and the last one.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / "sight.json"
    kept = _stored(path)
    wanted = cases if cases is not None else list(_cases(quick=quick))
    keys = [_key(look, scene) for _, look, scene in wanted]
    missing = {key: case for key, case in zip(keys, wanted, strict=True) if key not in kept}
    for count, row in enumerate(_made(missing, workers), start=len(wanted) - len(missing) + 1):
        kept[row.key] = row
        _write(path, [asdict(entry) for entry in kept.values()])
        if on_progress is not None:
            on_progress(count, len(wanted), row)
    rows = [kept[key] for key in keys]
    _write_table(rows, out / "sight.csv")
    return rows, summaries(rows)


def _made(cases: Mapping[str, Case], workers: int) -> Iterator[SightRow]:
    """Rows as they come, by the keys of their cases."""
    if workers == 1:
        yield from (_row(key, *case) for key, case in cases.items())
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        asked = [pool.submit(_row, key, *case) for key, case in cases.items()]
        try:
            yield from (done.result() for done in as_completed(asked))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def rows_on_disk(out: Path, *, cases: Sequence[Case] | None = None) -> list[SightRow]:
    """The sweep's rows, or those of other cases, that a folder holds of these versions, in order; none is measured."""
    kept = _stored(out / "sight.json")
    if not kept:
        return []
    keys = (_key(look, scene) for _, look, scene in cases or _cases(quick=False))
    return [kept[key] for key in keys if key in kept]


def summaries(rows: Sequence[SightRow]) -> list[SightSummary]:
    """The rows of each look together."""
    found = []
    for look in LOOKS:
        chosen = [row for row in rows if row.look == look]
        if not chosen:
            continue
        counts = np.array([row.errors for row in chosen], dtype=float)
        squares = np.array([row.rms_mm**2 for row in chosen])
        found.append(
            SightSummary(
                look=look,
                scenes=len(chosen),
                rms_mm=float(np.sqrt((counts * squares).sum() / counts.sum())),
                worst_rms_mm=max(row.rms_mm for row in chosen),
                coverage=float((counts * [row.coverage for row in chosen]).sum() / counts.sum()),
                same=sum(row.agrees for row in chosen),
                open=sum(row.verdict == "unresolved" for row in chosen),
                other=sum(row.verdict not in ("unresolved", row.judged) for row in chosen),
                take_ms=float(np.median([row.take_ms for row in chosen])),
            )
        )
    return found


def _cases(*, quick: bool) -> Iterator[Case]:
    """Loads, levels, frictions and fields from a seed: the same loads with markers and without."""
    for number in range(2 if quick else FILM_SCENES):
        load, level = FILM_LOADS[number % len(FILM_LOADS)], LEVELS_G[number % 4]
        scene = _scene(load, level, None).model_copy(update={"camera": Camera(seed=number)})
        yield f"{load}, {level:g} g", "film", scene
    chance = np.random.default_rng(SEED)
    for number in range(2 if quick else SCENES_A_LOOK):
        load, level = BARE_LOADS[number % len(BARE_LOADS)], LEVELS_G[number % len(LEVELS_G)]
        friction, tension = round(chance.uniform(0.35, 0.6), 2), round(10.0 ** chance.uniform(-0.5, 0.3), 2)
        # A third of them stands by friction alone, as far as it does.
        fields = None if number % 3 == 0 else ForceFields(tension=tension)
        for look in ("markers", "bare"):
            camera = Camera(markers=Markers() if look == "markers" else None, seed=number)
            scene = _scene(load, level, friction).model_copy(
                update={"force_fields": fields, "camera": camera}
            )
            told = "" if fields is None else f", T {tension:g}"
            yield f"{load}, {level:g} g, friction {friction:g}{told}", look, scene  # type: ignore[misc]


def _scene(name: str, level_g: float, friction: float | None) -> Scene:
    scene = overridden(read_scene(find_scene(name)), [f"sled.level_g={level_g}", 'solver={"engine":"auto"}'])
    if friction is not None:
        pairs = [["cardboard", "cardboard"], ["cardboard", "wood"]]
        named = json.dumps({"pairs": [{"between": pair, "friction": friction} for pair in pairs]})
        scene = overridden(scene, [f"surfaces={named}"])
    return with_setting(scene)[0]


def _key(look: Look, scene: Scene) -> str:
    told = json.dumps([FORMAT, look, scene.to_json(), versions_used()])
    return hashlib.sha256(told.encode()).hexdigest()


def versions_used() -> dict[str, str]:
    """Versions of all that draws, simulates and measures, and a digest of the code that does the last."""
    code = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        code.update(path.read_bytes())
    return versions(PICTURED) | {"sim_core/vision": code.hexdigest()[:12]}


def _row(key: str, name: str, look: Look, scene: Scene) -> SightRow:
    trial = picture_trial(scene)
    measured = {rule.rule: rule.state for rule in trial.measured.rules}
    unsettled = [rule for rule, state in measured.items() if state == "unresolved"]
    missed = [
        rule.rule for rule in trial.judged if measured.get(rule.rule) not in (rule.state, "unresolved", None)
    ]
    return SightRow(
        key=key,
        name=name,
        look=look,
        level_g=_level_g(scene),
        rms_mm=trial.rms_mm,
        largest_mm=trial.largest_mm,
        coverage=trial.coverage,
        errors=int(trial.checked.sum()),
        deviations=_deviations(trial),
        tracked=trial.tracked_share,
        verdict=trial.measured.verdict,
        judged=trial.verdict,
        agrees=trial.agrees,
        missed=" ".join(missed),
        unsettled=" ".join(unsettled),
        take_ms=1000.0 * float(np.median(trial.wall_s)),
        slowest_ms=1000.0 * float(np.percentile(trial.wall_s, 95)),
    )


def _deviations(trial: Trial) -> tuple[int, ...]:
    """How many errors, divided by their standard uncertainty, lie below, between and above ``DEVIATION_EDGES``."""
    checked = trial.checked
    share = (trial.displacement - trial.truth)[checked] / trial.sigma[checked]
    bins = np.searchsorted(DEVIATION_EDGES, share, side="right")
    return tuple(np.bincount(bins, minlength=len(DEVIATION_EDGES) + 1).tolist())


def _level_g(scene: Scene) -> float:
    assert isinstance(scene.sled, EumosSled)
    return scene.sled.level_g


def _stored(path: Path) -> dict[str, SightRow]:
    try:
        stored: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        rows = [SightRow(**{**entry, "deviations": tuple(entry["deviations"])}) for entry in stored]
        return {row.key: row for row in rows}
    except (OSError, ValueError, TypeError, KeyError):
        # None, or of another version: measured anew.
        return {}


def _write(path: Path, entries: list[dict[str, Any]]) -> None:
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(json.dumps(entries, indent=1), encoding="utf-8")
    scratch.replace(path)


def _write_table(rows: Sequence[SightRow], path: Path) -> None:
    scratch = path.with_name(path.name + ".part")
    with scratch.open("w", newline="", encoding="utf-8") as stream:
        told = [field.name for field in fields(SightRow) if field.name not in ("key", "deviations")]
        writer = csv.DictWriter(stream, told, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    scratch.replace(path)
