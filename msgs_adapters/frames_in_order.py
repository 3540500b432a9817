"""Poses and film of one test come on two topics, which have no order between them: here they get it back."""

from collections import deque
from collections.abc import Iterator

from config.errors import BrokenRecording
from config.scene import Scene
from msgs_adapters.film_payloads import film_frame_from_payload
from msgs_adapters.pose_payloads import pose_frame_from_payload
from sim_core.frames import FilmFrame, PoseFrame


class FramesInOrder:
    """Holds poses back until the film that is due with them is there, as ``sim_core.run.run_test`` gives both.

    Args:
        scene: the resolved scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._frames_a_film_frame = scene.sampling.frames_a_film_frame if scene.film is not None else None
        self._poses: deque[bytes] = deque()
        self._films: deque[bytes] = deque()
        self._count = 0

    def add_poses(self, payload: bytes) -> None:
        """Takes the next message of ``packages/poses``."""
        self._poses.append(payload)

    def add_film(self, payload: bytes) -> None:
        """Takes the next message of ``wrap/strain``."""
        self._films.append(payload)

    def ready(self) -> Iterator[tuple[PoseFrame, FilmFrame | None]]:
        """Gives out every pose frame that is complete, with the film that belongs to it or None.

        Raises:
            BrokenRecording: a message is not what its topic holds, or a frame of the film is missing.
        """
        every = self._frames_a_film_frame
        while self._poses:
            has_film = every is not None and self._count % every == 0
            if has_film and not self._films:
                return
            frame = pose_frame_from_payload(self._poses.popleft(), self._count)
            film = film_frame_from_payload(self._films.popleft(), self._count) if has_film else None
            if film is not None and film.stamp_ns != frame.stamp_ns:
                limit = f"must be that of frame {frame.index}, {frame.stamp_ns}"
                raise BrokenRecording("wrap/strain.header.stamp", film.stamp_ns, limit)
            self._count += 1
            yield frame, film
