"""What every way of drawing the bench offers to the renderer."""

from typing import Protocol

from sim_core.camera.sensor import Picture, Window
from sim_core.frames import Array, FilmFrame

Poses = tuple[Array, Array, Array]
"""Place of the sled in ``world`` [3], positions [n, 3] and orientations [n, 4] of pallet and packages in ``sled``."""


class Drawing(Protocol):
    """Something that draws the bench; colours are the square root of linear light."""

    described: str
    largest_part: tuple[int, int]

    def background(self) -> Picture:
        """What never moves, as the camera sees it, RGB, shape [height, width, 3]."""

    def outlines(self, poses: Poses) -> Array:
        """Points around all that moves [m], frame ``world``, a body a row, shape [bodies, n, 3]."""

    def light(self, poses: Poses, film: FilmFrame | None) -> None:
        """Casts the shadows of one picture."""

    def place(self, poses: Poses, film: FilmFrame | None) -> None:
        """Moves what moves."""

    def part(self, part: Window) -> Picture:
        """A part of the picture as it stands, RGBA, opacity already in its colours."""

    def close(self) -> None:
        """Gives the graphics back."""
