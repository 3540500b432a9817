"""The EUMOS 40509 judge: takes poses one frame at a time and can be asked for the rules at any moment."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.first_failure import FailureWatch, FirstFailure
from sim_core.frames import Array, FilmFrame, PoseFrame, RuleState
from sim_core.geometry import CORNER_SIGNS, box_corners, rotation_matrices

Verdict = Literal["pass", "fail", "unresolved"]
BAND_COUNT = 6
TOPPLED_TILT_DEG = 45.0
# Corners that share an edge or a face can be equally far out; the lowest number then wins, not rounding.
TIE_M = 1.0e-9
SAME_LAYER_M = 5.0e-3


@dataclass(frozen=True)
class PackageResult:
    """How far one package went.

    Attributes:
        id: the package's id.
        peak_mm: largest corner displacement until the end [mm].
        permanent_mm: largest corner displacement at the end [mm].
        final_displacement_mm: displacement of the centre at the end, x, y, z in frame ``sled`` [mm].
        final_tilt_deg: angle between the package's own z and up, at the end [deg].
    """

    id: str
    peak_mm: float
    permanent_mm: float
    final_displacement_mm: tuple[float, float, float]
    final_tilt_deg: float


@dataclass(frozen=True)
class Series:
    """Displacement over time by height band, every row the largest corner displacement in the band.

    Attributes:
        times_s: time since the first frame [s].
        band_edges_m: settled heights above the sled's top that bound the bands [m].
        displacement_mm: one row a band [mm]; empty bands are absent.
        bands: index of the band of each row.
    """

    times_s: list[float]
    band_edges_m: list[float]
    displacement_mm: list[list[float]]
    bands: list[int]


@dataclass(frozen=True)
class Moment:
    """A frame worth looking at: its name, its time since the first frame [s], and the poses."""

    name: str
    time_s: float
    frame: PoseFrame


class EumosJudge:
    """Judges a load unit by the displacement of its packages' corners relative to the sled.

    Displacement is the Euclidean distance of a corner from its place in the first frame, which must be
    the settled load. Elastic is the peak so far, permanent the distance in the newest frame: once the
    load has come to rest after the stop, that is what remains.

    Args:
        scene: a resolved scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._limits = scene.limits
        pallet = scene.pallet_box
        # Row 0 is the pallet; where there is none, a point on the sled that never moves.
        sizes = [pallet.size_m if pallet is not None else (0.0, 0.0, 0.0)]
        self._names = ["pallet"] + [package.id for package in scene.packages]
        self._half_sizes = 0.5 * np.array(sizes + [package.size_m for package in scene.packages])
        self._deck_m = pallet.size_m[2] if pallet is not None else 0.0
        self._layers = _layer_numbers(scene)
        self.frame_count = 0
        self._layer_peak = 0.0
        self._times: list[float] = []
        self._band_rows: list[Array] = []
        self._film: FilmFrame | None = None

    def add_film(self, frame: FilmFrame) -> None:
        """Takes the film at the pose frame of the same number, before or after that one."""
        self._film = frame

    @property
    def film(self) -> FilmFrame | None:
        """The newest frame of the film, or None without one."""
        return self._film

    def add(self, frame: PoseFrame) -> None:
        """Takes the next frame; the first one is the settled state.

        Raises:
            ValueError: the frame has another number of bodies than the scene.
        """
        if frame.positions.shape != self._half_sizes.shape:
            raise ValueError(
                f"frame has {len(frame.positions)} poses, the scene {len(self._half_sizes)} bodies"
            )
        corners = box_corners(frame.positions, frame.orientations, self._half_sizes)
        if self.frame_count == 0:
            self._begin(frame, corners)
        distance = np.linalg.norm(corners - self._settled, axis=2)
        time_s = (frame.stamp_ns - self._first_ns) / 1.0e9
        if self.frame_count == 0 or distance.max() > self._peak.max() + TIE_M:
            self.worst_frame = frame
        higher = distance > self._peak + TIE_M
        self._peak[higher] = distance[higher]
        self._peak_time[higher] = time_s
        self._now, self._now_s, self._newest = distance, time_s, frame
        self._failures.take(time_s, distance, self._lost)
        if self._limits.layer_fraction is not None:
            self._layer_peak = max(self._layer_peak, self._layer_shift())
        self._times.append(time_s)
        self._band_rows.append(np.maximum.reduceat(distance.ravel()[self._by_band], self._band_starts))
        self.frame_count += 1

    def _begin(self, frame: PoseFrame, corners: Array) -> None:
        self._first_ns = frame.stamp_ns
        self._settled, self._first = corners, frame
        self._peak = np.zeros(corners.shape[:2])
        self._peak_time = np.zeros(corners.shape[:2])
        self.height_m = float(corners[:, :, 2].max())
        self._on_pallet = corners[:, :, 2] <= self._deck_m + self._limits.base_height_m + TIE_M
        self._band_edges = np.linspace(
            self._deck_m, max(self.height_m, self._deck_m + 1.0e-3), BAND_COUNT + 1
        )
        band = np.clip(np.searchsorted(self._band_edges, corners[:, :, 2] - TIE_M) - 1, 0, BAND_COUNT - 1)
        limits = self._limits
        self._failures = FailureWatch(
            self._names,
            corners,
            self._on_pallet,
            permanent_m=limits.permanent_fraction * self.height_m,
            base_m=limits.base_permanent_m,
            elastic_m=limits.elastic_fraction * self.height_m,
        )
        is_package = (np.arange(len(corners)) > 0)[:, None]
        # Corners of packages, band after band, and where each band that has any begins.
        shown = np.where(is_package, band, BAND_COUNT).ravel()
        self._by_band = np.argsort(shown, kind="stable")[: int(is_package.sum()) * 8]
        self._bands, self._band_starts = np.unique(shown[self._by_band], return_index=True)

    def rules(self) -> list[RuleState]:
        """Every rule as it stands now, in the standard's order.

        Raises:
            ValueError: no frame has been taken yet.
        """
        if self.frame_count == 0:
            raise ValueError("the judge has seen no frame")
        limits, height = self._limits, self.height_m
        everywhere = np.ones_like(self._on_pallet)
        now = np.full_like(self._now, self._now_s)
        states = [
            self._corner_rule("permanent", "permanent displacement of any part", self._now, now,
                              limits.permanent_fraction * height, everywhere),
            self._corner_rule("permanent_on_pallet", "permanent displacement on the pallet", self._now, now,
                              limits.base_permanent_m, self._on_pallet),
            self._corner_rule("elastic", "elastic displacement of any part", self._peak, self._peak_time,
                              limits.elastic_fraction * height, everywhere),
            self._damage_rule(),
        ]  # fmt: skip
        if limits.layer_fraction is not None:
            states.append(self._layer_rule(limits.layer_fraction * height))
        return states

    def verdict(self) -> Verdict:
        """``fail`` when any rule fails as things stand, else ``pass``."""
        return verdict_of(self.rules())

    @property
    def peak_mm(self) -> float:
        """Largest displacement of any corner so far [mm]."""
        return 1000.0 * float(self._peak.max())

    def first_failure(self) -> FirstFailure | None:
        """The rule that was broken first, as things stand, or None while all hold."""
        torn_s = self._film.torn_s if self._film is not None else np.zeros(0)
        if torn_s.max(initial=-1.0) < 0.0 or self._film is None:
            return self._failures.first(None)
        first = int(np.where(torn_s >= 0.0, torn_s, np.inf).argmin())
        return self._failures.first((float(torn_s[first]), float(self._film.unrolled[first, :, 1].mean())))

    def packages(self) -> list[PackageResult]:
        """Every package's displacement so far, in scene order."""
        centres = 1000.0 * (self._newest.positions - self._first.positions)
        tilts = self._tilts_deg()
        return [
            PackageResult(
                id=name,
                peak_mm=1000.0 * float(self._peak[row].max()),
                permanent_mm=1000.0 * float(self._now[row].max()),
                final_displacement_mm=(
                    float(centres[row, 0]),
                    float(centres[row, 1]),
                    float(centres[row, 2]),
                ),
                final_tilt_deg=float(tilts[row]),
            )
            for row, name in enumerate(self._names)
            if row > 0
        ]

    def series(self, *, rate_hz: float = 60.0) -> Series:
        """Displacement by height band over time, thinned to at most ``rate_hz``, the peaks kept."""
        kept: list[int] = []
        rows = np.array(self._band_rows)
        peaks = set(rows.argmax(axis=0).tolist()) if len(self._bands) else set()
        for i, time_s in enumerate(self._times):
            is_due = not kept or time_s - self._times[kept[-1]] >= 1.0 / rate_hz - 1.0e-9
            if is_due or i in peaks or i == len(self._times) - 1:
                kept.append(i)
        return Series(
            times_s=[self._times[i] for i in kept],
            band_edges_m=self._band_edges.tolist(),
            displacement_mm=[[1000.0 * float(rows[i, k]) for i in kept] for k in range(len(self._bands))],
            bands=self._bands.tolist(),
        )

    def moments(self) -> list[Moment]:
        """The settled load, the moment of the largest displacement of any corner, and the newest frame."""
        named = [("settled", self._first), ("worst", self.worst_frame), ("end", self._newest)]
        return [Moment(name, (frame.stamp_ns - self._first_ns) / 1.0e9, frame) for name, frame in named]

    def _corner_rule(
        self,
        rule: str,
        title: str,
        displacement: Array,
        times: Array,
        limit_m: float,
        where: NDArray[np.bool_],
    ) -> RuleState:
        masked = np.where(where, displacement, -1.0)
        row, corner = divmod(int(np.argmax(masked > masked.max() - TIE_M)), 8)
        worst_mm, limit_mm = 1000.0 * float(masked[row, corner]), 1000.0 * limit_m
        # The standard words rule (ii) as "less than" and the others as "at most".
        passes = worst_mm < limit_mm if rule == "permanent_on_pallet" else worst_mm <= limit_mm
        return RuleState(
            rule=rule,
            title=title,
            state="pass" if passes else "fail",
            limit_mm=limit_mm,
            worst_mm=worst_mm,
            margin_mm=limit_mm - worst_mm,
            package=self._names[row],
            corner=corner,
            time_s=float(times[row, corner]),
            height_m=float(self._settled[row, corner, 2]),
        )

    def _damage_rule(self) -> RuleState:
        """Rigid packages don't crush: what is judged here is a package that toppled or fell, and film that tore."""
        tilts, lost = self._tilts_deg(), self._lost()
        row = int(np.argmax(np.where(lost, np.maximum(tilts, 1.0), 0.0)))
        found = bool(lost.any())
        package, time_s = self._names[row], self._now_s
        height_m = float(self._first.positions[row, 2])
        title = "structural damage: a package toppled or fallen"
        if self._film is not None:
            title += ", or film torn"
            torn_s = self._film.torn_s
            if not found and torn_s.max(initial=-1.0) >= 0.0:
                first = int(np.where(torn_s >= 0.0, torn_s, np.inf).argmin())
                found, package, time_s = True, "film", float(torn_s[first])
                height_m = float(self._film.unrolled[first, :, 1].mean())
        return RuleState(
            rule="damage",
            title=title,
            state="fail" if found else "pass",
            limit_mm=None,
            worst_mm=None,
            margin_mm=None,
            package=package if found else None,
            time_s=time_s if found else None,
            height_m=height_m if found else None,
        )

    def _layer_rule(self, limit_m: float) -> RuleState:
        worst_mm, limit_mm = 1000.0 * self._layer_peak, 1000.0 * limit_m
        return RuleState(
            rule="layers",
            title="displacement of layer against layer",
            state="pass" if worst_mm <= limit_mm else "fail",
            limit_mm=limit_mm,
            worst_mm=worst_mm,
            margin_mm=limit_mm - worst_mm,
        )

    def _layer_shift(self) -> float:
        """Largest difference between the mean displacements of two neighbouring layers [m]."""
        moved = self._newest.positions - self._first.positions
        numbers = np.unique(self._layers[self._layers > 0])
        means = [moved[self._layers == number].mean(axis=0) for number in numbers]
        return max((float(np.linalg.norm(b - a)) for a, b in pairwise(means)), default=0.0)

    def _lost(self) -> NDArray[np.bool_]:
        """Which bodies have toppled or fallen; never the pallet."""
        drop = self._first.positions[:, 2] - self._newest.positions[:, 2]
        lost: NDArray[np.bool_] = (self._tilts_deg() > TOPPLED_TILT_DEG) | (
            drop > np.maximum(self._half_sizes[:, 2], 0.02)
        )
        lost[0] = False
        return lost

    def _tilts_deg(self) -> Array:
        up = rotation_matrices(self._newest.orientations)[:, 2, 2]
        tilts: Array = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
        return tilts


def _layer_numbers(scene: Scene) -> NDArray[np.int64]:
    """Layer of every row, from 1; 0 for the pallet. Where a package names none, all go by their bottoms' heights."""
    if all(package.layer is not None for package in scene.packages):
        return np.array([0] + [package.layer or 0 for package in scene.packages])
    bottoms = np.array([package.position_m[2] - package.size_m[2] / 2.0 for package in scene.packages])
    ordered = np.sort(bottoms)
    starts = ordered[np.concatenate([[True], np.diff(ordered) > SAME_LAYER_M])]
    layers: NDArray[np.int64] = np.concatenate([[0], np.searchsorted(starts, bottoms + SAME_LAYER_M / 2.0)])
    return layers


def verdict_of(rules: list[RuleState]) -> Verdict:
    """The verdict that a set of rule states gives."""
    if any(rule.state == "fail" for rule in rules):
        return "fail"
    return "unresolved" if any(rule.state == "unresolved" for rule in rules) else "pass"


def corner_name(corner: int) -> str:
    """A corner in words that name the package's own axes, such as ``+x -y +z``."""
    return " ".join(
        f"{'+' if sign > 0 else '-'}{axis}" for sign, axis in zip(CORNER_SIGNS[corner], "xyz", strict=True)
    )
