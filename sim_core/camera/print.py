"""What is printed on and stuck to the packages and the sled: carton faces, AprilTag sheets, quadrant targets."""

import cv2
import numpy as np

from config.camera import MARKER_DICTIONARIES
from config.errors import RefusedInput
from config.package import Package
from sim_core.camera.carton import carton_design, carton_pictures
from sim_core.camera.containers import container_faces
from sim_core.camera.surfaces import Picture


def carton_faces(package: Package, *, seed: int, pixels_per_m: float = 700.0) -> tuple[Picture, ...]:
    """Six faces of a package, as each is seen from outside.

    Args:
        package: its size, mass and surface choose the design; its id the wear.
        seed: of the scene's camera.
        pixels_per_m: resolution; a face longer than 4096 px is made coarser.

    Returns:
        Faces -x, +x, -y, +y, -z, +z of the package's own frame, each RGB, shape [rows, columns, 3]. Row 0 is on top:
        at +z of the four sides, at +y of the top and the bottom. Seen from outside, columns run to the right:
        along -y, +y, +x, -x, -x, +x.

    Raises:
        RefusedInput: the resolution isn't a positive, finite number.
    """
    others = container_faces(package, seed=seed, pixels_per_m=pixels_per_m)
    if others is not None:
        return others
    x, y, z = package.size_m
    mass, surface = package.mass_kg, package.surface
    design = carton_design(max(x, y), min(x, y), z, mass, surface, seed, pixels_per_m)
    seen = carton_pictures(design, package.id, seed)
    if x >= y:
        return tuple(seen[name] for name in ("left", "right", "front", "back", "bottom", "top"))
    # The seam runs along y: the carton stands a quarter turn counter-clockwise.
    sides = tuple(seen[name] for name in ("back", "front", "left", "right"))
    return (
        *sides,
        np.ascontiguousarray(np.rot90(seen["bottom"], -1)),
        np.ascontiguousarray(np.rot90(seen["top"])),
    )


def quadrant_target(size_px: int) -> Picture:
    """A round target on white, its edge touching the picture's: quadrants upper left and lower right black.

    Returns:
        RGB, shape [size_px, size_px, 3]; the four quadrants meet in the picture's very middle.

    Raises:
        RefusedInput: the size is below 8 px or above 4096 px.
    """
    if not 8 <= size_px <= 4096:
        raise RefusedInput("size_px", size_px, "must be 8 to 4096")
    fine = 8 * size_px
    along = np.abs(np.arange(fine) - 0.5 * (fine - 1))
    inside = along[:, None] ** 2 + along[None, :] ** 2 <= (0.5 * fine) ** 2
    low = np.arange(fine) < fine // 2
    black = inside & (low[:, None] == low[None, :])
    grey = cv2.resize(
        np.where(black, 0, 255).astype(np.uint8), (size_px, size_px), interpolation=cv2.INTER_AREA
    )
    return np.asarray(cv2.merge([grey, grey, grey]), np.uint8)


def tag_sheet(dictionary: str, tag: int, size_px: int) -> Picture:
    """An AprilTag on a white sheet whose edge is 1.25 times that of the black square.

    Args:
        dictionary: one of ``config.camera.MARKER_DICTIONARIES``.
        tag: its number in the dictionary.
        size_px: edge of the sheet [px].

    Returns:
        RGB, shape [size_px, size_px, 3].

    Raises:
        RefusedInput: no such dictionary or tag, or fewer than two pixels a module.
    """
    if dictionary not in MARKER_DICTIONARIES:
        raise RefusedInput("dictionary", dictionary, f"must be one of {', '.join(MARKER_DICTIONARIES)}")
    tags = cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{dictionary.replace('apriltag', 'APRILTAG')}")
    )
    count = len(tags.bytesList)
    if not 0 <= tag < count:
        raise RefusedInput("tag", tag, f"must be 0 to {count - 1} in {dictionary}")
    modules = tags.markerSize + 2
    if not 2.5 * modules <= size_px <= 4096:
        raise RefusedInput("size_px", size_px, f"must be {int(np.ceil(2.5 * modules))} to 4096")
    # Eight pixels a module let the quiet zone, an eighth of the edge, be a whole number of them.
    square = cv2.aruco.generateImageMarker(tags, tag, 8 * modules)
    sheet = cv2.copyMakeBorder(square, modules, modules, modules, modules, cv2.BORDER_CONSTANT, value=255)
    scale = -(-size_px // len(sheet)) * 2
    fine = sheet.repeat(scale, axis=0).repeat(scale, axis=1)
    grey = cv2.resize(fine, (size_px, size_px), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.merge([grey, grey, grey]), np.uint8)
