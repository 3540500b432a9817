"""One picture's content: where sled, packages and film are while the shutter is open."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from config.scene import Scene
from sim_core.camera.moments import PictureMoments
from sim_core.frames import Array, FilmFrame, PoseFrame


@dataclass(frozen=True, eq=False)
class Shot:
    """What is in front of the camera at one stamp, and just before it.

    Attributes:
        index: running number of the picture, from 0.
        stamp_ns: simulated time at which the shutter closes [ns].
        sled: place of the sled in frame ``world`` [m], shape [3].
        velocity: of the sled [m/s], shape [3].
        positions: centres of pallet (row 0) and packages in frame ``sled`` [m], shape [n, 3].
        orientations: unit quaternions x, y, z, w, shape [n, 4].
        earlier_positions: the same, ``interval_s`` before, shape [n, 3].
        earlier_orientations: the same, shape [n, 4].
        interval_s: time between the two [s]; 0 for a first picture, which has no earlier one.
        film: the film as it was published last, or None without one.
    """

    index: int
    stamp_ns: int
    sled: Array
    velocity: Array
    positions: Array
    orientations: Array
    earlier_positions: Array
    earlier_orientations: Array
    interval_s: float
    film: FilmFrame | None = None

    def before(self, time_s: float) -> tuple[Array, Array, Array]:
        """Sled [3], positions [n, 3] and orientations [n, 4] so long before the stamp [s], by straight lines."""
        share = time_s / self.interval_s if self.interval_s > 0.0 else 0.0
        positions = self.positions + share * (self.earlier_positions - self.positions)
        signs = np.sign(np.sum(self.orientations * self.earlier_orientations, axis=1, keepdims=True))
        turned = self.orientations + share * (signs * self.earlier_orientations - self.orientations)
        return (
            self.sled - time_s * self.velocity,
            positions,
            turned / np.linalg.norm(turned, axis=1, keepdims=True),
        )


class ShotsInOrder:
    """Makes the shots of a test from the sled's motion, pose frames and film, which come on topics of their own.

    Args:
        scene: a resolved scene that has a camera.
    """

    def __init__(self, scene: Scene) -> None:
        self._moments = PictureMoments(scene)
        self._motions: dict[int, tuple[Array, Array]] = {}
        self._waiting: deque[tuple[int, PoseFrame, PoseFrame, FilmFrame | None]] = deque()
        self._earlier: PoseFrame | None = None
        self._film: FilmFrame | None = None

    def add_motion(self, stamp_ns: int, position: Array, velocity: Array) -> None:
        """Takes the sled's place [m] and velocity [m/s] in frame ``world`` at a stamp, each shape [3]."""
        self._motions[stamp_ns] = (position, velocity)

    def add_frame(self, frame: PoseFrame, film: FilmFrame | None) -> None:
        """Takes the next pose frame, with the film where there is one of the same number."""
        earlier, self._earlier = self._earlier, frame
        self._film = film if film is not None else self._film
        number = self._moments.number(frame.index)
        if number is not None:
            self._waiting.append((number, frame, earlier if earlier is not None else frame, self._film))

    def ready(self) -> Iterator[Shot]:
        """Gives out every shot of which all is known, in order."""
        while self._waiting and self._waiting[0][1].stamp_ns in self._motions:
            number, frame, before, film = self._waiting.popleft()
            position, velocity = self._motions[frame.stamp_ns]
            self._motions = {at: motion for at, motion in self._motions.items() if at > frame.stamp_ns}
            yield Shot(
                index=number,
                stamp_ns=frame.stamp_ns,
                sled=position,
                velocity=velocity,
                positions=frame.positions,
                orientations=frame.orientations,
                earlier_positions=before.positions,
                earlier_orientations=before.orientations,
                interval_s=(frame.stamp_ns - before.stamp_ns) * 1.0e-9,
                film=film,
            )
