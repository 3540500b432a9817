"""Takes the pictures of a test that runs in this process."""

from collections.abc import Callable, Sequence

from config.scene import Scene
from sim_core.camera.shot import Shot, ShotsInOrder
from sim_core.camera.source import DrawnPictures, Picture
from sim_core.frames import AccelerometerSample, FilmFrame, PoseFrame, RuleState, SledSample


class ShotTaker:
    """Follows a test and keeps what is in front of its camera at each picture; a ``TestObserver``.

    Args:
        scene: a resolved scene that has a camera.

    Attributes:
        shots: in order.
    """

    __test__ = False

    def __init__(self, scene: Scene) -> None:
        self.shots: list[Shot] = []
        self._shots = ShotsInOrder(scene)
        self._samples_a_frame = scene.sampling.samples_hz // scene.sampling.poses_hz
        self._frames_a_film_frame = scene.sampling.frames_a_film_frame if scene.film is not None else None
        self._waiting: PoseFrame | None = None

    def on_reading(self, reading: AccelerometerSample) -> None:
        """Not seen."""

    def on_sample(self, sample: SledSample) -> None:
        """See ``TestObserver``."""
        if sample.index % self._samples_a_frame == 0:
            self._shots.add_motion(sample.stamp_ns, sample.position, sample.velocity)

    def on_frame(self, frame: PoseFrame) -> None:
        """See ``TestObserver``; a frame with which film is due waits for it."""
        if self._frames_a_film_frame is not None and frame.index % self._frames_a_film_frame == 0:
            self._waiting = frame
            return
        self._add(frame, None)

    def on_film(self, frame: FilmFrame) -> None:
        """See ``TestObserver``."""
        assert self._waiting is not None
        self._add(self._waiting, frame)

    def on_rules(self, stamp_ns: int, rules: list[RuleState]) -> None:
        """Not seen."""

    def take(self, shot: Shot) -> None:
        """Takes the next shot."""
        self.shots.append(shot)

    def _add(self, frame: PoseFrame, film: FilmFrame | None) -> None:
        self._shots.add_frame(frame, film)
        for shot in self._shots.ready():
            self.take(shot)


class PictureTaker(ShotTaker):
    """Draws each shot as it comes.

    Args:
        scene: a resolved scene that has a camera.
        readers: called with each picture, in order.

    Raises:
        RefusedInput: the camera cannot see what it should.
    """

    def __init__(self, scene: Scene, readers: Sequence[Callable[[Picture], None]]) -> None:
        super().__init__(scene)
        self.source = DrawnPictures(scene)
        self._readers = readers

    def take(self, shot: Shot) -> None:
        """Draws the next shot."""
        picture = self.source.picture(shot)
        for reader in self._readers:
            reader(picture)

    def close(self) -> None:
        """Frees the source."""
        self.source.close()
