"""Which rule a load breaks first, where and when.

A permanent displacement is broken from the moment after which it never comes back inside its limit; a peak and a
damage from the moment that they are there. Of the rules that have failed at the end the earliest is the first; rules
that are broken in one frame stand in the standard's order.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class FirstFailure:
    """The first broken rule.

    Attributes:
        rule: its name.
        time_s: since the first frame [s].
        package: the package, ``pallet`` or ``film``.
        corner: number of the package's corner, or None where it is no corner's matter.
        height_m: settled height of the place above the sled's top [m].
    """

    rule: str
    time_s: float
    package: str
    corner: int | None
    height_m: float


@dataclass
class _Limit:
    rule: str
    limit_m: float
    where: Mask
    is_permanent: bool
    is_strict: bool
    since_s: float = np.nan
    place: int = 0

    def take(self, time_s: float, displacement: Array) -> None:
        if not self.is_permanent and self.since_s == self.since_s:
            return
        masked = np.where(self.where, displacement, -1.0).ravel()
        place = int(masked.argmax())
        is_broken = masked[place] >= self.limit_m if self.is_strict else masked[place] > self.limit_m
        if not is_broken:
            self.since_s = np.nan
        elif self.since_s != self.since_s:
            self.since_s, self.place = time_s, place


class FailureWatch:
    """Follows a test frame by frame.

    Args:
        names: of pallet and packages, length n.
        settled: corners of the settled load in frame ``sled`` [m], shape [n, 8, 3].
        on_pallet: corners that rule (ii) is about, shape [n, 8].
        permanent_m: limit of rule (i) [m].
        base_m: limit of rule (ii) [m].
        elastic_m: limit of rule (iii) [m].
    """

    def __init__(
        self,
        names: list[str],
        settled: Array,
        on_pallet: Mask,
        *,
        permanent_m: float,
        base_m: float,
        elastic_m: float,
    ) -> None:
        everywhere = np.ones_like(on_pallet)
        self._names, self._heights = names, settled[:, :, 2]
        self._limits = [
            _Limit("permanent", permanent_m, everywhere, is_permanent=True, is_strict=False),
            _Limit("permanent_on_pallet", base_m, on_pallet, is_permanent=True, is_strict=True),
            _Limit("elastic", elastic_m, everywhere, is_permanent=False, is_strict=False),
        ]
        self._lost_s = np.full(len(names), np.nan)

    def take(self, time_s: float, displacement: Array, lost: Callable[[], Mask]) -> None:
        """Takes a frame.

        Args:
            time_s: since the first frame [s].
            displacement: of the corners [m], shape [n, 8].
            lost: which bodies have toppled or fallen, shape [n]; asked only once a limit is broken, for a package
                that falls has gone far.
        """
        for limit in self._limits:
            limit.take(time_s, displacement)
        if any(limit.since_s == limit.since_s for limit in self._limits):
            gone = lost()
            self._lost_s = np.where(gone, np.fmin(self._lost_s, time_s), np.nan)

    def first(self, torn: tuple[float, float] | None) -> FirstFailure | None:
        """The first broken rule as things stand, or None where all hold.

        Args:
            torn: when [s] and how high [m] the film first tore, or None.
        """
        found: list[FirstFailure] = []
        for limit in self._limits:
            if limit.since_s == limit.since_s:
                row, corner = divmod(limit.place, 8)
                height = float(self._heights[row, corner])
                found.append(FirstFailure(limit.rule, limit.since_s, self._names[row], corner, height))
        if np.isfinite(self._lost_s).any():
            row = int(np.nanargmin(self._lost_s))
            height = float(self._heights[row].mean())
            found.append(FirstFailure("damage", float(self._lost_s[row]), self._names[row], None, height))
        if torn is not None:
            found.append(FirstFailure("damage", torn[0], "film", None, torn[1]))
        return min(found, key=lambda failure: failure.time_s, default=None)
