"""What a file of rerun holds, row by row."""

from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

Rows = dict[str, list[tuple[float | None, dict[str, Any]]]]


def rows_of(file: Path) -> Rows:
    """By entity, simulated time [s] (None where static) and components of each row, in order of time."""
    found: Rows = {}
    for chunk in RrdReader(file).stream().to_chunks():
        batch = chunk.to_record_batch()
        assert not {"log_time", "log_tick"} & set(batch.schema.names), chunk.entity_path
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names if ":" in name}
        # Python's timedelta, which pyarrow would make of the times, holds no nanoseconds.
        times: list[float | None] = [None] * batch.num_rows
        if not chunk.is_static:
            times = (batch.column("sim_time").cast("int64").to_numpy() * 1.0e-9).tolist()
        for row, time_s in enumerate(times):
            values = {name: column[row] for name, column in columns.items() if column[row] is not None}
            found.setdefault(chunk.entity_path, []).append((time_s, values))
    return {path: sorted(rows, key=lambda row: row[0] or 0.0) for path, rows in found.items()}


def moving(rows: Rows, path: str, component: str) -> tuple[list[float], list[Any]]:
    """Times [s] and values of a component."""
    pairs = [(t, values[component]) for t, values in rows[path] if t is not None and component in values]
    return [t for t, _ in pairs], [value for _, value in pairs]
