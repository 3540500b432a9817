"""Where pictures come from: drawn here, or from anything else that has them."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from sim_core.camera.jpeg import jpeg_of, picture_of
from sim_core.camera.renderer import BenchRenderer
from sim_core.camera.shot import Shot
from sim_core.camera.view import CameraView


class Picture:
    """One picture, as pixels and as JPEG; the one that it was not made of is made when it is asked for.

    Args:
        index: running number, from 0.
        stamp_ns: simulated time at which the shutter closed [ns].
        pixels: RGB, shape [height, width, 3].
        jpeg: the same as JPEG; one of the two has to be given.
    """

    def __init__(
        self, index: int, stamp_ns: int, *, pixels: NDArray[np.uint8] | None = None, jpeg: bytes | None = None
    ) -> None:
        self.index, self.stamp_ns = index, stamp_ns
        self._pixels, self._jpeg = pixels, jpeg

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """RGB, shape [height, width, 3].

        Raises:
            BrokenRecording: the bytes are no picture.
        """
        if self._pixels is None:
            assert self._jpeg is not None
            self._pixels = picture_of(self._jpeg)
        return self._pixels

    @property
    def jpeg(self) -> bytes:
        """The picture as JPEG."""
        if self._jpeg is None:
            assert self._pixels is not None
            self._jpeg = jpeg_of(self._pixels)
        return self._jpeg


class PictureSource(Protocol):
    """Something that has a picture for every shot of a test."""

    @property
    def view(self) -> CameraView:
        """The camera."""

    @property
    def described(self) -> str:
        """What makes the pictures, for the log."""

    def picture(self, shot: Shot) -> Picture:
        """The picture of a shot.

        Raises:
            RefusedInput: there is none.
        """

    def close(self) -> None:
        """Frees what it holds."""


class DrawnPictures:
    """Draws pictures of a scene.

    Args:
        scene: a resolved scene that has a camera.

    Raises:
        RefusedInput: the camera cannot see what it should.
    """

    def __init__(self, scene: Scene) -> None:
        self._renderer = BenchRenderer(scene)

    @property
    def view(self) -> CameraView:
        """See ``PictureSource``."""
        return self._renderer.view

    @property
    def described(self) -> str:
        """See ``PictureSource``."""
        return self._renderer.described

    def picture(self, shot: Shot) -> Picture:
        """See ``PictureSource``."""
        return Picture(shot.index, shot.stamp_ns, pixels=self._renderer.picture(shot))

    def close(self) -> None:
        """See ``PictureSource``."""
        self._renderer.close()
