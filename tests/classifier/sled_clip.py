"""A drawn clip whose every point is known: a board with targets and a printed load slide past a tilted camera."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = (480, 270)
FOCAL_PX = 620.0
BEND = -0.06
DISTANCE_M, BEHIND_M = 4.5, 0.03
BOARD_M, LOAD_M = (1.7, 0.2), (1.2, 1.1)
TEXELS_A_M = 400


@dataclass(frozen=True)
class SledClip:
    """Pictures, and how far the load's upper half stands from its first place in each [m]."""

    pictures: list[NDArray[np.uint8]]
    slip_m: NDArray[np.float64]


def sled_clip(
    *,
    count: int = 16,
    travel_m: float = 1.5,
    slip_m: float = 0.08,
    still: int = 2,
    behind_m: float = BEHIND_M,
) -> SledClip:
    """Stands for ``still`` pictures, slides evenly; the upper half of the load goes out in the middle and comes back."""
    noise = np.random.default_rng(5)
    backdrop = cv2.resize(
        noise.integers(60, 120, (20, 36, 3), dtype=np.uint8), (960, 540), interpolation=cv2.INTER_CUBIC
    )
    texels = (int(LOAD_M[1] * TEXELS_A_M), int(LOAD_M[0] * TEXELS_A_M))
    print_ = cv2.resize(
        noise.integers(90, 250, (22, 24, 3), dtype=np.uint8), texels[::-1], interpolation=cv2.INTER_NEAREST
    )
    board = _board()
    travel = travel_m * np.clip((np.arange(count) - still) / (count - 1 - still), 0.0, None)
    slip = np.interp(np.arange(count), [still, count // 2, count - 1], [0.0, slip_m, 0.2 * slip_m])
    pictures = []
    half = texels[0] // 2
    for gone, slid in zip(travel - 0.5 * travel_m, slip, strict=True):
        picture = backdrop.copy()
        left = gone - 0.5 * LOAD_M[0]
        for image, x, top, behind in (
            (print_[half:], left, -0.5 * LOAD_M[1], behind_m),
            (print_[:half], left + slid, -LOAD_M[1], behind_m),
            (board, gone - 0.5 * BOARD_M[0], 0.02, 0.0),
        ):
            _paste(picture, image, x, top, behind)
        small = cv2.resize(_bent(picture), SIZE, interpolation=cv2.INTER_AREA)
        grain = noise.normal(scale=1.0, size=small.shape)
        pictures.append(np.clip(small + grain, 0, 255).astype(np.uint8))
    return SledClip(pictures, slip)


def _board() -> NDArray[np.uint8]:
    """A white board with seven quadrant targets of 35 mm radius in two rows by turns."""
    board = np.full((int(BOARD_M[1] * TEXELS_A_M), int(BOARD_M[0] * TEXELS_A_M), 3), 225, np.uint8)
    rows, columns = np.mgrid[: board.shape[0], : board.shape[1]] / TEXELS_A_M
    for number, x in enumerate(np.linspace(0.05, BOARD_M[0] - 0.05, 7)):
        y = 0.151 if number % 2 else 0.049
        inside = (columns - x) ** 2 + (rows - y) ** 2 < 0.035**2
        board[inside & ((columns < x) == (rows < y))] = 15
    return board


def _paste(picture: NDArray[np.uint8], image: NDArray[np.uint8], x: float, top: float, behind: float) -> None:
    """Draws a flat thing where a camera turned by 4° aside and 3° down sees it, without its lens."""
    aside, down = np.deg2rad(4.0), np.deg2rad(-3.0)
    turn = cv2.Rodrigues(np.array([down, 0.0, 0.0]))[0] @ cv2.Rodrigues(np.array([0.0, aside, 0.0]))[0]
    height, width = image.shape[0] / TEXELS_A_M, image.shape[1] / TEXELS_A_M
    corners = np.array([[x, top], [x + width, top], [x + width, top + height], [x, top + height]])
    points = np.column_stack((corners + [0.0, 0.5], np.full(4, DISTANCE_M + behind))) @ turn.T
    seen = 2.0 * FOCAL_PX * points[:, :2] / points[:, 2:] + 0.5 * np.array(picture.shape[1::-1]) - 0.5
    texels = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * image.shape[1::-1] - 0.5
    matrix = cv2.getPerspectiveTransform(texels.astype(np.float32), seen.astype(np.float32))
    drawn = cv2.warpPerspective(image, matrix, picture.shape[1::-1], flags=cv2.INTER_LINEAR)
    mask = cv2.warpPerspective(np.ones(image.shape[:2], np.float32), matrix, picture.shape[1::-1])[..., None]
    picture[:] = (picture * (1.0 - mask) + drawn * mask).astype(np.uint8)


def _bent(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture through the lens: each pixel looks where the bent ray comes from."""
    matrix = np.array([[2.0 * FOCAL_PX, 0.0, 479.5], [0.0, 2.0 * FOCAL_PX, 269.5], [0.0, 0.0, 1.0]])
    pixels = np.stack(np.meshgrid(np.arange(960.0), np.arange(540.0)), axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, matrix, np.array([BEND, 0.0, 0.0, 0.0]))
    source = (rays * 2.0 * FOCAL_PX + matrix[:2, 2]).reshape(540, 960, 2).astype(np.float32)
    return np.asarray(cv2.remap(picture, source[..., 0], source[..., 1], cv2.INTER_LINEAR), dtype=np.uint8)
