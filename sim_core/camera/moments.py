"""When the camera takes its pictures: at a rate, or so many over the whole test."""

from bisect import bisect_left

from config.scene import Scene
from sim_core.sled import stop_sample

REST_S = 0.25
"""The last of a given number of pictures is taken so long after the stop: no test ends earlier [s]."""


class PictureMoments:
    """Which pose frames are taken as pictures.

    Args:
        scene: a resolved scene that has a camera.

    Attributes:
        rate_hz: pictures a second, on average where ``camera.pictures`` says how many there are.
    """

    def __init__(self, scene: Scene) -> None:
        assert scene.camera is not None
        poses_hz, wanted = scene.sampling.poses_hz, scene.camera.pictures
        self._every, self._frames = 1, None
        if wanted is None:
            self._every, self.rate_hz = poses_hz // scene.camera.rate_hz, float(scene.camera.rate_hz)
            return
        # Behind film a picture shows the film of its own frame.
        step = scene.sampling.frames_a_film_frame if scene.film is not None else 1
        last = int((stop_sample(scene) / scene.sampling.samples_hz + REST_S) * poses_hz + 1.0e-6) // step
        self._frames = sorted({step * round(last * k / (wanted - 1)) for k in range(wanted)})
        self.rate_hz = (len(self._frames) - 1) * poses_hz / self._frames[-1]

    def number(self, frame: int) -> int | None:
        """The running number of the picture that a pose frame is taken as, or None."""
        if self._frames is None:
            return frame // self._every if frame % self._every == 0 else None
        place = bisect_left(self._frames, frame)
        return place if place < len(self._frames) and self._frames[place] == frame else None

    def count(self, frames: int) -> int:
        """How many pictures there are among the first so many pose frames."""
        return -(-frames // self._every) if self._frames is None else bisect_left(self._frames, frames)
