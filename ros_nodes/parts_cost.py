"""What each optional part of a test costs: the same scene with every part on and off, a fresh process each."""

import tempfile
from collections.abc import Callable, Collection
from pathlib import Path

from config.errors import RefusedInput
from config.scene import Scene
from ros_nodes.parts import Variant, variants
from ros_nodes.parts_page import table_of, write_tables
from ros_nodes.parts_run import Graph, Run, graph_apart, run_apart
from sim_core.integrity import require_integrity


def measure_parts(
    scene: Scene,
    out: Path,
    *,
    repeats: int = 5,
    only: Collection[str] = (),
    on_progress: Callable[[int, int, object], None] | None = None,
) -> None:
    """Measures what each optional part costs and writes ``parts.json``, ``parts.csv`` and ``parts.md``.

    Every variant runs once to count calls, which also warms the caches, then ``repeats`` times in turn
    (a b c a b c ...), so that noise of the machine hits all alike. Of ``bare`` and ``all`` the node graph is
    started once as well.

    Args:
        scene: a resolved scene.
        out: folder for the tables, made where it is missing; tables of an earlier measurement are replaced.
        repeats: timed runs of every variant.
        only: names of rows to measure beside ``bare_loop`` and ``bare``; empty for all.
        on_progress: called with runs done, runs in all, and the name of the one that ended.

    Raises:
        RefusedInput: the load fails its integrity check, the folder cannot be made, there is no such row, or
            another twin runs in this ROS domain.
        NodeDied: a run, or a node of a graph, ended before its time.
    """
    if repeats < 1:
        raise RefusedInput("repeats", repeats, "at least 1")
    require_integrity(scene)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedInput("--out", str(out), error.strerror or "cannot be made") from None
    rows, omitted = _chosen(scene, only)
    with_graph = [row for row in rows if row.name in ("bare", "all")]
    done, total = 0, len(with_graph) + (1 + repeats) * len(rows)

    def count(row: Variant) -> None:
        nonlocal done
        done += 1
        if on_progress is not None:
            on_progress(done, total, row.name)

    shown: dict[str, Graph] = {}
    traced: dict[str, Run] = {}
    timed: dict[str, list[Run]] = {row.name: [] for row in rows}
    with tempfile.TemporaryDirectory(prefix="parts-", dir=out) as scratch:
        for row in with_graph:
            shown[row.name] = graph_apart(row, Path(scratch) / f"graph_{row.name}")
            count(row)
        for row in rows:
            traced[row.name] = run_apart(row, Path(scratch) / row.name, traced=True)
            count(row)
        for _ in range(repeats):
            for row in rows:
                timed[row.name].append(run_apart(row, Path(scratch) / row.name))
                count(row)
    write_tables(table_of(scene, rows, timed, traced, shown, omitted), out)


def _chosen(scene: Scene, only: Collection[str]) -> tuple[list[Variant], dict[str, str]]:
    rows, omitted = variants(scene)
    names = [row.name for row in rows]
    for name in only:
        if name not in names:
            raise RefusedInput("--only", name, omitted.get(name, f"must be one of {', '.join(names)}"))
    return [row for row in rows if not only or row.name in {"bare_loop", "bare", *only}], omitted
