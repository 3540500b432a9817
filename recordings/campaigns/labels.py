"""Label rows: what each test of a campaign came to, the same bytes for the same test."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from config.errors import BrokenRecording
from recordings.campaigns.drafts import Factors, flat
from sim_core.report import Report

FORMAT = 1
"""Version of label rows on disk; raise it when a field or its meaning changes."""
RULES = ("permanent", "permanent_on_pallet", "elastic", "damage")
"""Those of the standard; ``layers`` is there where a scene sets its limit."""
FACTOR = "factor."
"""What the columns of drawn factors begin with."""


@dataclass(frozen=True)
class Label:
    """What one test came to.

    Attributes:
        number: of the draw; the test's folder is named after it.
        weight: how many draws of the campaign's ranges the test stands for, where a balance chose it; else 1.
        factors: what was drawn.
        packages: how many there are.
        mass_kg: of the load.
        height_m: of the load unit above the sled's top.
        verdict: ``pass``, ``fail`` or ``unresolved``, error estimate and all.
        judged: by the poses alone.
        first_rule: rule that was broken first, see ``sim_core/first_failure.py``; None where none was.
        first_time_s: when [s].
        first_package: where: a package, ``pallet`` or ``film``.
        first_corner: the package's corner, in its own axes.
        first_height_m: settled height of the place [m].
        states: of each rule, error estimate and all.
        worst_mm: of each rule that has a limit.
        margin_mm: of each of them.
        error_mm: estimate of each of them, where there is one.
        estimate_problem: why there is no estimate.
        ended_by: monitor that ended the test, with its reason.
        engine: rigid engine.
        time_step_s: its step at the end [s].
        penetration_mm: deepest contact.
        energy_residual: largest share of energy that appeared from nowhere.
        simulated_s: length of the test [s].
        pictures: how many the bag holds.
        scene_sha256: digest of the scene.
        bag_sha256: digest of the bag, see ``bag_digest``.
        bag_bytes: its size.
    """

    number: int
    weight: float
    factors: Factors
    packages: int
    mass_kg: float
    height_m: float | None
    verdict: str
    judged: str
    first_rule: str | None
    first_time_s: float | None
    first_package: str | None
    first_corner: str | None
    first_height_m: float | None
    states: dict[str, str]
    worst_mm: dict[str, float]
    margin_mm: dict[str, float]
    error_mm: dict[str, float]
    estimate_problem: str | None
    ended_by: str | None
    engine: str
    time_step_s: float
    penetration_mm: float
    energy_residual: float
    simulated_s: float
    pictures: int
    scene_sha256: str
    bag_sha256: str
    bag_bytes: int

    @property
    def success(self) -> bool | None:
        """True for a pass, False for a fail, None for a test that settles nothing: it is not learned from."""
        return {"pass": True, "fail": False}.get(self.verdict)

    def to_json(self) -> str:
        """The row as JSON, the same bytes for the same row."""
        # In the order of the factors, which is that of a table's columns.
        return json.dumps({"format": FORMAT, **asdict(self)}, ensure_ascii=False, allow_nan=False)

    def row(self) -> dict[str, Any]:
        """The row as a table holds it: factors and rules in columns of their own."""
        mapped = ("factors", "states", "worst_mm", "margin_mm", "error_mm")
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in mapped}
        rules = {
            f"{rule}.{name}": getattr(self, what).get(rule)
            for rule in (*RULES, *(["layers"] if "layers" in self.states else []))
            for name, what in (
                ("state", "states"), ("worst_mm", "worst_mm"), ("margin_mm", "margin_mm"), ("error_mm", "error_mm"),
            )
            if rule != "damage" or name == "state"
        }  # fmt: skip
        return {
            **plain,
            "success": self.success,
            **rules,
            **{FACTOR + k: v for k, v in flat(self.factors).items()},
        }


def label_from_json(text: str, source: str) -> Label:
    """Reads a row.

    Raises:
        BrokenRecording: it is no row, or one of another format.
    """
    try:
        raw = json.loads(text)
        if raw.pop("format") != FORMAT:
            raise BrokenRecording("label", source, f"is not of format {FORMAT}; run the campaign again")
        return Label(**raw)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BrokenRecording("label", source, f"is no label row: {error}") from None


def label_of(
    report: Report,
    *,
    number: int,
    weight: float,
    factors: Factors,
    pictures: int,
    judged: str,
    estimate_problem: str | None,
    bag_sha256: str,
    bag_bytes: int,
) -> Label:
    """The row of a test from its full report.

    Args:
        report: see ``full_report``.
        number: of the draw.
        weight: see ``Label``.
        factors: what was drawn.
        pictures: how many the bag holds.
        judged: verdict by the poses alone.
        estimate_problem: see ``Label``.
        bag_sha256: digest of the bag.
        bag_bytes: its size.
    """
    rules = {rule["rule"]: rule for rule in report["rules"]}
    first = report["first_failure"] or {}
    numerics = report["numerics"]
    return Label(
        number=number,
        weight=weight,
        factors=factors,
        packages=report["load"]["package_count"],
        mass_kg=report["load"]["mass_kg"],
        height_m=report["height_m"],
        verdict=report["verdict"],
        judged=judged,
        first_rule=first.get("rule"),
        first_time_s=first.get("time_s"),
        first_package=first.get("package"),
        first_corner=first.get("corner_name"),
        first_height_m=first.get("height_m"),
        states={name: rule["state"] for name, rule in rules.items()},
        worst_mm={name: rule["worst_mm"] for name, rule in rules.items() if rule["worst_mm"] is not None},
        margin_mm={name: rule["margin_mm"] for name, rule in rules.items() if rule["margin_mm"] is not None},
        error_mm={name: rule["error_mm"] for name, rule in rules.items() if rule.get("error_mm") is not None},
        estimate_problem=estimate_problem,
        ended_by=numerics["ended_by"],
        engine=numerics["engine"],
        time_step_s=numerics["smallest_step_s"],
        penetration_mm=numerics["max_penetration_mm"],
        energy_residual=numerics["energy_residual"],
        simulated_s=numerics["simulated_s"],
        pictures=pictures,
        scene_sha256=report["scene_sha256"],
        bag_sha256=bag_sha256,
        bag_bytes=bag_bytes,
    )


def label_table(labels: Sequence[Label]) -> pa.Table:
    """All rows as a table, by number; a column that some rows lack is empty there."""
    return table_of([label.row() for label in sorted(labels, key=lambda label: label.number)])


def write_parquet(table: pa.Table, path: Path) -> None:
    """Writes a table, whole or not at all; the same table gives the same bytes with the same library."""
    scratch = path.with_name(path.name + ".part")
    pq.write_table(table, scratch, compression="zstd")
    scratch.replace(path)


def table_of(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as a table; what a row lacks is empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return pa.table({name: _column([row.get(name) for row in rows]) for name in names})


def _column(values: Sequence[Any]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and float in kinds:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if len(kinds) > 1:
        return pa.array([None if value is None else str(value) for value in values], pa.string())
    return pa.array(values, None if kinds else pa.string())
