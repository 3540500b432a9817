"""The records that flow through a test: sled samples in, pose frames out, rule states at the end."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.81
"""Acceleration of free fall [m/s²], rounded as in EN 12195-1; also converts levels given in g."""


@dataclass(frozen=True)
class SledSample:
    """One sample of the sled's motion along the bench, in frame ``world``.

    The acceleration is the mean over the interval that ends at the stamp, so that
    ``acceleration · interval`` is the exact change of velocity whatever the profile's shape.

    Attributes:
        index: 0 for the sample at which the test begins; its interval is empty.
        stamp_ns: simulated time [ns].
        interval_s: time since the sample before [s].
        acceleration: mean acceleration over the interval [m/s²], shape [3].
        velocity: velocity at the stamp [m/s], shape [3].
        position: travel at the stamp [m], shape [3].
    """

    index: int
    stamp_ns: int
    interval_s: float
    acceleration: Array
    velocity: Array
    position: Array


@dataclass(frozen=True)
class AccelerometerSample:
    """One reading of the sled's accelerometer: specific force in frame ``sled`` (REP-145).

    Attributes:
        stamp_ns: simulated time [ns].
        specific_force: reading [m/s²], shape [3]; at rest (0, 0, +g).
        variance: variance of each axis [m²/s⁴].
    """

    stamp_ns: int
    specific_force: Array
    variance: float


@dataclass(frozen=True)
class PoseFrame:
    """Poses of the pallet (row 0) and of every package in scene order, in frame ``sled``.

    Attributes:
        index: running number of the frame, from 0.
        stamp_ns: simulated time [ns].
        positions: centres [m], shape [package_count + 1, 3].
        orientations: unit quaternions x, y, z, w, shape [package_count + 1, 4].
    """

    index: int
    stamp_ns: int
    positions: Array
    orientations: Array


@dataclass(frozen=True, eq=False)
class FilmFrame:
    """The film around the load, an element a row, as it is published: float32.

    Strains count from the tension-free film.

    Attributes:
        index: running number of the pose frame that it belongs to.
        stamp_ns: simulated time [ns].
        corners: places of the elements' corners, frame ``sled`` [m], shape [m, 3, 3].
        unrolled: the same corners on the film unrolled as it was laid: way around the load, counter-clockwise from
            above, and height above the sled [m], shape [m, 3, 2].
        strains: the largest in any direction, around the load, and up its side, shape [m, 3].
        peaks: the largest strain in any direction so far, shape [m].
        forces: largest pull in any direction, of all layers [N/m], shape [m].
        torn_s: when the element tore, since the first frame [s], or -1 while it is whole, shape [m].
    """

    index: int
    stamp_ns: int
    corners: NDArray[np.float32]
    unrolled: NDArray[np.float32]
    strains: NDArray[np.float32]
    peaks: NDArray[np.float32]
    forces: NDArray[np.float32]
    torn_s: NDArray[np.float32]


@dataclass(frozen=True)
class RuleState:
    """How one EUMOS rule stands.

    Attributes:
        rule: short name, such as ``permanent``.
        title: the rule in words.
        state: ``pass``, ``fail``, ``unresolved``, or ``off`` when the scene switches the rule off.
        limit_mm: the limit [mm]; none for the damage rule.
        worst_mm: the largest displacement so far that the rule applies to [mm].
        margin_mm: limit − worst [mm].
        package: id of the package with the worst corner.
        corner: that corner's number, 0 to 7: bit 0 is +x, bit 1 is +y, bit 2 is +z of the package.
        time_s: when, in seconds since the first sample.
        height_m: settled height of that corner above the sled's top [m].
        error_mm: error estimate of ``worst_mm`` [mm], where one was made.
    """

    rule: str
    title: str
    state: Literal["pass", "fail", "unresolved", "off"]
    limit_mm: float | None
    worst_mm: float | None
    margin_mm: float | None
    package: str | None = None
    corner: int | None = None
    time_s: float | None = None
    height_m: float | None = None
    error_mm: float | None = None
