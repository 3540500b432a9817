"""How far each part of the load has moved on the sled, in metres, by dense optical flow against the first picture."""

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from classifier.sled_board import Board
from classifier.sled_motion import SledMotion
from sim_core.frames import Array

Grey = NDArray[np.uint8]
Field = NDArray[np.float32]
P = TypeVar("P", np.uint8, np.float32)

WINDOW_PX = 224
"""Edge of the square in which the load is followed, and that rides on the sled."""
GRID_PX = 112
"""Edge of the grid on which displacement is kept; flow is smoother than print."""
CHANNELS = 9
"""Of a frame: the first picture's grey, displacement along and down in heights of the load, the same in metres, the
parallax that was taken off, a tenth of the sled's travel, what the flow does not explain, and what was not there in the
first picture."""
DISPLACED = slice(1, 5)
"""Those of them that are displacement: two vectors, along and down."""
ALONG = slice(5, 7)
"""Those of them that are lengths along the picture."""
FULL = 1.0
"""Displacement, in heights or in metres, that counts as full, and as no more than that."""
SPACING_M = (0.22, 0.255, 0.29)
"""Of the targets along the board: least, usual, most; 0.24 m on a EUR pallet's shorter side, 0.267 m on the other."""
_ROWS_M = 0.102
"""Between the upper and the lower row of targets."""
WINDOW_M = 2.1
"""Edge of the window: a load of 1.75 m on its pallet, with the board below it."""
_BELOW_BOARD = 0.3
"""How far the window reaches below the lower row of targets, in spacings."""
_UNKNOWN_WIDTH_M = 4.0
"""Of what a picture without a board shows."""
_SIGHT_PX = 480
"""About so wide pictures are looked at: a finer one says no more about centimetres, and takes longer."""
_NODES_PX = 8
_AROUND = (0.3, 0.15, 0.3, 0.12)
"""What is shown to the left of the load, above, to its right and below, in widths and heights of it."""
_INSIDE = (0.25, 0.2, 0.75, 0.85)
"""Left, top, right and bottom of the part of the load's outline that is load for certain, in widths and heights."""
_LEAST_EDGE = 0.05
"""Of the load's outline, in edges of the window."""
_RATES = np.linspace(-0.12, 0.004, 125)
"""Of the load's parallax for each metre of travel; at most as of one that stands an eighth of the distance deeper."""
_PICTURES_APART = 6
"""Between which movement is compared with travel: neighbours differ by less than the flow's noise."""
_STILL_M = 0.001
"""Of movement between two pictures; that the flow finds where nothing moves."""
_USUALLY_NONE = 0.1
"""Of all weight; speaks for no parallax, to within ``_NO_RATE``: most loads reach to the pallet's edge."""
_NO_RATE = 0.003
_TOP_SPEED = 0.97
"""Of the highest speed, that is as good as the highest."""
_PARALLAX_STEP = 6
"""Of the grid on which parallax is looked for."""


@dataclass(frozen=True, eq=False)
class Followed:
    """A picture against the first one.

    Attributes:
        flow: from the first picture's window to this one's [px of the window], shape [GRID_PX, GRID_PX, 2].
        unlike: grey levels by which it differs where the flow leads, shape [GRID_PX, GRID_PX].
        fresh: grey levels by which it differs from the first picture in the same place of the picture, not of the sled:
            what is behind the bench stays the same, and packages that fall out beside the load do not.
        place: the affine map from the window to this picture [px], shape [2, 3].
    """

    flow: Field
    unlike: Grey
    fresh: Grey
    place: Array


@dataclass(frozen=True)
class Outline:
    """Where load and pallet stand in the first picture: edges on the grid, and their height [m]."""

    left: float
    top: float
    right: float
    bottom: float
    height_m: float

    def inside(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom of what is load for certain, within the grid and not empty."""
        width, height = self.right - self.left, self.bottom - self.top
        left, right = (self.left + share * width for share in _INSIDE[0::2])
        top, bottom = (self.top + share * height for share in _INSIDE[1::2])
        first = [min(max(0, int(edge)), GRID_PX - 1) for edge in (left, top)]
        last = [
            min(max(int(np.ceil(edge)), low + 1), GRID_PX)
            for edge, low in zip((right, bottom), first, strict=True)
        ]
        return first[0], first[1], last[0], last[1]

    def shown(self, size_px: int) -> Array:
        """The affine map from a frame of that edge, with the load and a little around it, to the grid, shape [2, 3]."""
        width, height = self.right - self.left, self.bottom - self.top
        left, above, right, below = _AROUND
        x, y = self.left - left * width, self.top - above * height
        along, down = (1.0 + left + right) * width / size_px, (1.0 + above + below) * height / size_px
        return np.array([[along, 0.0, x + 0.5 * along - 0.5], [0.0, down, y + 0.5 * down - 0.5]])


class LoadFollower:
    """Follows every part of the load through the pictures of a clip, in their order.

    Each picture is brought back to where the first one was by the sled's targets, roughly; dense inverse search
    (Kroeger et al., ECCV 2016) then says where each part of the first picture is, beginning with where it was in the
    picture before. What the rough map lacks of the sled's true motion is taken off by ``displacement``, once all is
    known.

    Args:
        grey: the first picture, shape [height, width].
        board: the targets in it, or None: then the window is the picture's middle, and stands still.
    """

    def __init__(self, grey: Grey, board: Board | None) -> None:
        height, width = grey.shape
        self._finer = max(1, round(width / _SIGHT_PX))
        if board is None:
            edge, left, top = float(height), 0.5 * (width - height), 0.0
            metres_a_px = _UNKNOWN_WIDTH_M / width
        else:
            places, along = board.places, board.pattern[:, 0]
            spacing = float(np.linalg.norm(places[-1] - places[0]) / (along[-1] - along[0]))
            metres_a_px = _spacing_m(board, spacing) / spacing
            edge = WINDOW_M / metres_a_px
            bottom = float(places[:, 1].max()) + _BELOW_BOARD * spacing
            left, top = 0.5 * float(places[:, 0].min() + places[:, 0].max()) - 0.5 * edge, bottom - edge
        self._board = board
        self._metres_a_px = metres_a_px
        scale = edge / WINDOW_PX
        self._window: Array = np.array(
            [[scale, 0.0, left + 0.5 * scale - 0.5], [0.0, scale, top + 0.5 * scale - 0.5]]
        )
        self._search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        # The preset ends at half of the window's pixels. At whole ones far fewer packages are lost, and there a wider
        # grid of patches and fewer rounds do as well in two thirds of the time.
        self._search.setFinestScale(0)
        self._search.setPatchStride(4)
        self._search.setGradientDescentIterations(12)
        self._search.setVariationalRefinementIterations(3)
        rows, columns = np.mgrid[:WINDOW_PX, :WINDOW_PX].astype(np.float32)
        self._columns, self._rows = columns, rows
        self._flow: Field = np.zeros((WINDOW_PX, WINDOW_PX, 2), dtype=np.float32)
        self._place = self._window
        self._first = self._seen(grey, self._window)
        self.grey: Grey = _on_grid(self._first)
        self._whole = grey
        self.followed: list[Followed] = []

    def follow(self, grey: Grey, targets: Array | None) -> None:
        """Takes the next picture, the first one included.

        Args:
            grey: shape [height, width].
            targets: places of the board's targets in it [px], shape [n, 2]; NaN where they are not seen.
        """
        # The first one is where it is, whatever its targets are measured to be.
        self._place = self._placed(targets) if self.followed else self._window
        seen = self._seen(grey, self._place)
        if self.followed:
            self._flow = np.asarray(self._search.calc(self._first, seen, self._flow), dtype=np.float32)
        led = cv2.remap(
            seen,
            self._columns + self._flow[..., 0],
            self._rows + self._flow[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        unlike = np.asarray(cv2.absdiff(led, self._first), dtype=np.uint8)
        fresh = self._seen(np.asarray(cv2.absdiff(grey, self._whole), dtype=np.uint8), self._place)
        self.followed.append(Followed(_on_grid(self._flow), _on_grid(unlike), _on_grid(fresh), self._place))

    def displacement(self, number: int, motion: SledMotion | None) -> Field:
        """Displacement on the sled, along the picture and down [m], shape [GRID_PX, GRID_PX, 2].

        Args:
            number: of the picture.
            motion: of the sled over all pictures; None: that of the rough map alone.
        """
        found = self.followed[number]
        moved: Field = found.flow * np.float32(self._window[0, 0] * self._metres_a_px)
        if motion is None:
            return moved
        step = GRID_PX // _NODES_PX
        # The map is smooth: a node every so many says it all.
        at = (np.arange(step) + 0.5) * _NODES_PX * (WINDOW_PX / GRID_PX) - 0.5
        nodes = np.stack(np.meshgrid(at, at), axis=-1)
        foretold = motion.carried(motion.straight(_mapped(self._window, nodes)), number)
        # Where the sled's own motion takes each node, seen in the window that the rough map gave.
        linear = found.place[:, :2]
        off = (foretold - found.place[:, 2]) @ np.linalg.inv(linear).T - nodes
        smooth = cv2.resize(off.astype(np.float32), (GRID_PX, GRID_PX), interpolation=cv2.INTER_LINEAR)
        return np.asarray(
            moved - smooth * np.float32(self._window[0, 0] * self._metres_a_px), dtype=np.float32
        )

    def travel_m(self, motion: SledMotion | None) -> Array:
        """How far the sled had come along the picture at each picture [m]; 0 where it is not followed, shape [n]."""
        if motion is None:
            return np.zeros(len(self.followed))
        middle = motion.straight(_mapped(self._window, np.full(2, 0.5 * (WINDOW_PX - 1.0))))
        places = np.array([motion.carried(middle, number)[0] for number in range(len(self.followed))])
        travel: Array = (places - places[0]) * self._metres_a_px
        return travel

    def outline(self, load: tuple[float, float, float, float] | None) -> Outline:
        """Where the load is on the grid.

        Args:
            load: left, top, right and bottom of load and pallet in the first picture [px]; None: the window's middle.
        """
        scale, offset = self._window[0, 0] * WINDOW_PX / GRID_PX, self._window[:, 2]
        if load is None:
            left, top, right, bottom = 0.25 * GRID_PX, 0.2 * GRID_PX, 0.75 * GRID_PX, 0.9 * GRID_PX
        else:
            left, right = (load[0] - offset[0]) / scale, (load[2] - offset[0]) / scale
            top, bottom = (load[1] - offset[1]) / scale, (load[3] - offset[1]) / scale
        least = _LEAST_EDGE * GRID_PX
        top, right = min(top, bottom - least), max(right, left + least)
        return Outline(left, top, right, bottom, (bottom - top) * scale * self._metres_a_px)

    def _placed(self, targets: Array | None) -> Array:
        """The map from the window to a picture: turned, sized and shifted as the targets are, or as before."""
        if targets is None or self._board is None:
            return self._place
        good = np.isfinite(targets).all(axis=1)
        if good.sum() < 3:
            return self._place
        return _composed(_fitted_similarity(self._board.places[good], targets[good]), self._window)

    def _seen(self, grey: Grey, place: Array) -> Grey:
        """What a picture shows in the window, shape [WINDOW_PX, WINDOW_PX]."""
        if self._finer > 1:
            height, width = (edge // self._finer for edge in grey.shape)
            grey = np.asarray(
                cv2.resize(
                    grey[: height * self._finer, : width * self._finer],
                    (width, height),
                    interpolation=cv2.INTER_AREA,
                ),
                dtype=np.uint8,
            )
            # Pixel centres: x = f·x' + (f − 1)/2.
            shift = 0.5 * (self._finer - 1)
            place = np.column_stack((place[:, :2], place[:, 2] - shift)) / self._finer
        return np.asarray(
            cv2.warpAffine(
                grey,
                place,
                (WINDOW_PX, WINDOW_PX),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            dtype=np.uint8,
        )


def mean_displacement(displacement: Field, outline: Outline) -> float:
    """Mean length of the displacement well inside the load [m]."""
    left, top, right, bottom = outline.inside()
    part = displacement[top:bottom, left:right]
    return float(np.hypot(part[..., 0], part[..., 1]).mean())


def parallax_rate(displacement: Field, travel_m: Array, outline: Outline) -> float:
    """How far the load seems to slide for each metre that the sled comes along, because it stands behind the board.

    A point that stands deeper than the board by the share δ of the camera's distance comes along by δ less of the
    sled's travel. A load does not slide all the time that the sled brakes, and while it stands on the sled, all of its
    movement is parallax: the rate is the one that the most of its parts agree with in the most pictures.

    Args:
        displacement: of all pictures [m], shape [n, GRID_PX, GRID_PX, 2].
        travel_m: of the sled along the picture [m], shape [n].
        outline: of the load.

    Returns:
        The rate, from -0.12 to 0.004; 0 where too little is seen.
    """
    if len(travel_m) <= 2 * _PICTURES_APART:
        return 0.0
    left, top, right, bottom = outline.inside()
    # The upper half is the first to slide, and can slide evenly.
    top = (top + bottom) // 2
    parts = displacement[:, top:bottom:_PARALLAX_STEP, left:right:_PARALLAX_STEP, 0]
    parts = parts.reshape(len(parts), -1)
    travelled = travel_m[_PICTURES_APART:] - travel_m[:-_PICTURES_APART]
    moved = parts[_PICTURES_APART:] - parts[:-_PICTURES_APART]
    # From the sled's highest speed on; one that keeps its speed is as good.
    speed = np.abs(travelled)
    braking = slice(int(np.argmax(speed > _TOP_SPEED * speed.max())), None)
    moved, travelled = moved[braking], travelled[braking]
    weights = np.abs(travelled)
    if weights.sum() < _STILL_M:
        return 0.0
    weights = weights / weights.sum()
    rates, found = _RATES, 0.0
    for _ in range(2):
        left_over = moved[None] - rates[:, None, None] * travelled[None, :, None]
        agree = np.exp(-0.5 * (left_over / _STILL_M) ** 2).mean(axis=2) @ weights
        usual = _USUALLY_NONE * np.exp(-0.5 * (rates / _NO_RATE) ** 2)
        found = float(rates[np.argmax(agree + usual)])
        # Then as finely as the flow allows: 0.1 mm for each metre.
        rates = found + np.linspace(-1.0e-3, 1.0e-3, 21)
    return found


def packed_motion(
    grey: Grey,
    displacement: Field,
    followed: Followed,
    outline: Outline,
    size_px: int,
    *,
    parallax_m: float = 0.0,
    travel_m: float = 0.0,
) -> NDArray[np.uint8]:
    """A frame of bytes, shape [size_px, size_px, CHANNELS], in which each load's outline has the same place.

    Limits are shares of the load's height, and 40 mm on the pallet: so displacement is told in both.

    Args:
        grey: of the first picture, shape [GRID_PX, GRID_PX].
        displacement: [m], shape [GRID_PX, GRID_PX, 2].
        followed: the picture.
        outline: of the load.
        size_px: edge of the frame.
        parallax_m: along the picture, that was taken off the displacement [m].
        travel_m: of the sled along the picture [m].
    """
    shown = outline.shown(size_px)
    seen, moved, unlike, fresh = (
        cv2.warpAffine(
            plane,
            shown,
            (size_px, size_px),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for plane in (grey, displacement, followed.unlike, followed.fresh)
    )
    both = np.dstack((moved / np.float32(outline.height_m), moved))
    lengths = packed_displacement(np.array([parallax_m, 0.1 * travel_m], dtype=np.float32))
    flat = np.broadcast_to(lengths, (size_px, size_px, 2))
    return np.dstack((seen, packed_displacement(both), flat, unlike, fresh)).astype(np.uint8)


def packed_displacement(displacement: Field) -> NDArray[np.uint8]:
    """Displacement as bytes of its signed root, so that they are fine where it is small; 128 is none.

    A step is 3 mm at 40 mm and 5 mm at 100 mm.
    """
    root = np.sqrt(np.minimum(np.abs(displacement), np.float32(FULL)) / np.float32(FULL))
    return np.round(np.float32(128.0) + np.float32(127.0) * np.copysign(root, displacement)).astype(np.uint8)


def unpacked_displacement(packed: NDArray[np.uint8]) -> Field:
    """Displacement that ``packed_displacement`` made bytes of."""
    root = (packed.astype(np.float32) - np.float32(128.0)) / np.float32(127.0)
    return np.asarray(root * np.abs(root) * np.float32(FULL), dtype=np.float32)


def _spacing_m(board: Board, spacing: float) -> float:
    """Of the targets along the board [m], by how far apart the rows look.

    A camera that looks down by 15° sees the rows 3 % too close, and rows of 10 px are known to as much. So the usual
    spacing counts for as much as what is seen.
    """
    design = np.column_stack((board.pattern, np.ones(len(board.pattern))))
    along, down = np.linalg.lstsq(design, board.places, rcond=None)[0][:2]
    apart = abs(along[0] * down[1] - along[1] * down[0]) / np.linalg.norm(along)
    seen = _ROWS_M * spacing / max(1.0e-6, float(apart * np.ptp(board.pattern[:, 1])))
    least, usual, most = SPACING_M
    return 0.5 * (usual + min(max(seen, least), most))


def _on_grid(plane: NDArray[P]) -> NDArray[P]:
    return cv2.resize(plane, (GRID_PX, GRID_PX), interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def _mapped(affine: Array, places: Array) -> Array:
    mapped: Array = places @ affine[:, :2].T + affine[:, 2]
    return mapped


def _composed(outer: Array, inner: Array) -> Array:
    """The affine map that does the inner one, then the outer."""
    return np.column_stack((outer[:, :2] @ inner[:, :2], outer[:, :2] @ inner[:, 2] + outer[:, 2]))


def _fitted_similarity(start: Array, end: Array) -> Array:
    """The turn, size and shift that take points to points with the least squares, shape [2, 3] (Umeyama, 1991)."""
    from_middle, to_middle = start - start.mean(axis=0), end - end.mean(axis=0)
    square = float((from_middle**2).sum())
    along = float((from_middle * to_middle).sum()) / square
    across = float((from_middle[:, 0] * to_middle[:, 1] - from_middle[:, 1] * to_middle[:, 0]).sum()) / square
    linear = np.array([[along, -across], [across, along]])
    return np.column_stack((linear, end.mean(axis=0) - linear @ start.mean(axis=0)))
