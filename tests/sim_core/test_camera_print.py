"""Textures: the same arguments give the same bytes, faces fit together at their edges, and print says what is true."""

import time

import cv2
import numpy as np
import pytest

from config.camera import MARKER_DICTIONARIES
from config.errors import RefusedInput
from config.materials import material_library
from config.package import Package
from sim_core.camera import artwork, carton, containers, surfaces
from sim_core.camera.print import carton_faces, quadrant_target, tag_sheet
from sim_core.camera.product import check_digit, product_of

MATERIALS = (
    surfaces.wood,
    surfaces.concrete,
    surfaces.steel,
    surfaces.plywood,
    surfaces.kraft_paper,
    surfaces.board,
)


def _package(size, *, name="a", mass=10.0, surface="cardboard", kind="package"):
    return Package(id=name, size_m=size, mass_kg=mass, position_m=(0.0, 0.0, 0.0), surface=surface, kind=kind)


def _forget():
    for cached in (carton.carton_design, carton._sheets, carton._label_art, containers._drawn):
        cached.cache_clear()


@pytest.mark.parametrize("surface", [*material_library().surfaces, "not in the library"])
def test_every_surface_has_six_faces_of_the_right_size(surface):
    faces = carton_faces(_package((0.4, 0.3, 0.25), surface=surface), seed=3)
    assert [face.shape for face in faces] == [
        (175, 210, 3), (175, 210, 3), (175, 280, 3), (175, 280, 3), (210, 280, 3), (210, 280, 3)
    ]  # fmt: skip
    assert all(face.dtype == np.uint8 and face.std() > 2.0 for face in faces)


@pytest.mark.parametrize(
    "size",
    [(0.05, 0.05, 0.05), (2.0, 0.4, 0.3), (0.05, 0.4, 0.3), (0.8, 0.6, 0.003), (0.3, 0.2, 1.2), (0.001,) * 3],
)
@pytest.mark.parametrize("surface", ["cardboard", "plastic", "stretch_film", "wood"])
def test_extreme_sizes_are_drawn(size, surface):
    for face in carton_faces(_package(size, surface=surface, mass=0.02), seed=1):
        assert min(face.shape[:2]) >= surfaces.SHORTEST_SIDE_PX


def test_a_face_is_never_larger_than_a_texture_may_be():
    faces = carton_faces(_package((10.0, 0.2, 0.1)), seed=1)
    assert max(max(face.shape) for face in faces) == surfaces.LONGEST_SIDE_PX
    assert faces[2].shape[:2] == (41, 4096)


@pytest.mark.parametrize("surface", ["cardboard", "plastic", "shrink_film", "wood"])
def test_same_arguments_same_bytes_whatever_was_drawn_before(surface):
    package = _package((0.35, 0.25, 0.2), surface=surface)
    _forget()
    first = carton_faces(package, seed=5)
    state = np.random.get_state()[1].copy()
    _forget()
    carton_faces(_package((0.35, 0.25, 0.2), name="other", surface=surface), seed=5)
    carton_faces(package, seed=6)
    again = carton_faces(package, seed=5)
    assert all(np.array_equal(one, two) for one, two in zip(first, again, strict=True))
    assert np.array_equal(np.random.get_state()[1], state)


def test_materials_are_seeded():
    for material in (*MATERIALS, surfaces.fold_heights):
        one, same, other = (material(0.5, 0.2, seed=seed) for seed in (4, 4, 5))
        assert np.array_equal(one, same)
        assert not np.array_equal(one, other)
        assert one.shape[:2] == (140, 350)


def test_cartons_of_a_product_share_their_print_but_not_their_wear():
    faces = {
        name: carton_faces(_package((0.4, 0.3, 0.25), name=name), seed=8)[3].astype(float) for name in "ab"
    }
    other = carton_faces(_package((0.4, 0.3, 0.25), mass=11.0), seed=8)[3].astype(float)
    small = [cv2.GaussianBlur(face, (0, 0), 2.0) for face in (faces["a"], faces["b"], other)]
    correlations = [np.corrcoef(small[0].ravel(), face.ravel())[0, 1] for face in small[1:]]
    assert not np.array_equal(faces["a"], faces["b"])
    assert correlations[0] > 0.85 > 0.6 > correlations[1]


def test_print_tells_the_packages_size_and_mass_whichever_way_it_stands():
    assert product_of((0.4, 0.3, 0.25), 10.0, "cardboard", 2).size_text == "400 × 300 × 250 mm"
    assert product_of((0.399, 0.297, 0.003), 10.0, "cardboard", 2).size_text == "400 × 297 × 3 mm"
    assert product_of((0.4, 0.3, 0.25), 7.25, "cardboard", 2).weight_text == "7.2 kg"
    laid = product_of((0.4, 0.25, 0.3), 10.0, "cardboard", 2)
    cut = product_of((0.399, 0.299, 0.25), 10.0, "cardboard", 2)
    assert laid.brand == cut.brand == product_of((0.4, 0.3, 0.25), 10.0, "cardboard", 2).brand


def test_bar_codes_can_be_read():
    # GS1's own example of a check digit: GTIN-13 6291041500213.
    assert check_digit("629104150021") == "3"
    digits = product_of((0.4, 0.3, 0.25), 10.0, "cardboard", 2).digits
    assert check_digit(digits[:-1]) == digits[-1]
    plate = artwork.Plate(0.15, 0.02, 6000.0)
    plate.bars(artwork.itf_elements(digits), 0.005, 0.0, 0.14, 0.02)
    dark = plate.mask[60] > 127
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate(([False], dark, [False])).astype(int))))
    wide = runs[4:-3] > 1.7 * np.median(runs[:4])
    patterns = wide.reshape(-1, 5, 2).transpose(0, 2, 1).reshape(-1, 5)
    read = ["".join("1" if element else "0" for element in pattern) for pattern in patterns]
    assert "".join(str(artwork._ITF_DIGITS.index(pattern)) for pattern in read) == digits


def _taped(size):
    """A package closed with opaque tape on brown board that lies well off the middle, and the seed of its product."""
    for seed in range(200):
        product = product_of((max(size[:2]), min(size[:2]), size[2]), 10.0, "cardboard", seed)
        if product.tape and product.tape_opacity > 0.85 and product.liner[2] < 150.0:
            return seed
    raise AssertionError("no such product")


# To the right in the pictures of faces -x, +x, -y, +y, -z, +z; upwards is z, but y for the last two.
_RIGHT = np.array([[0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [-1, 0, 0], [1, 0, 0]])
_UP = np.array([[0, 0, 1]] * 4 + [[0, 1, 0]] * 2)


def _tape_place(picture, face, axis, strip):
    """Place of the tape along a body axis [m], from those pixels of a face that the strip, a box in the face, names."""
    rows, columns = picture.shape[:2]
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns - 0.5, 0.5 - (np.arange(rows) + 0.5) / rows)
    inside = (u > strip[0]) & (u < strip[1]) & (v > strip[2]) & (v < strip[3])
    lengthwise = abs(_RIGHT[face][axis])
    profile = np.nanmean(np.where(inside, picture[:, :, 2], np.nan), axis=0 if lengthwise else 1)
    dark = np.flatnonzero(profile < 0.5 * (np.nanmin(profile) + np.nanmedian(profile)))
    place = np.median(dark) + 0.5 - 0.5 * len(profile)
    return place / 700.0 * (_RIGHT[face][axis] if lengthwise else -_UP[face][axis])


@pytest.mark.filterwarnings("ignore:Mean of empty slice")
@pytest.mark.parametrize("size", [(0.5, 0.3, 0.3), (0.3, 0.5, 0.3)])
def test_tape_goes_on_over_the_edges(size):
    seed, along, across = _taped(size), int(size[1] > size[0]), int(size[0] >= size[1])
    offsets = []
    for name in "abcdef":
        faces = [face.astype(float) for face in carton_faces(_package(size, name=name), seed=seed)]
        for sign in (-1, 1):
            end = 2 * along + (sign > 0)
            for lid, upper in ((5, True), (4, False)):
                # The strip of top or bottom beside this end, and that of the end beside top or bottom.
                direction = sign * (_RIGHT[lid] + _UP[lid])[along]
                near = (0.465, 0.485) if direction > 0 else (-0.485, -0.465)
                beside = (*near, -1, 1) if abs(_RIGHT[lid][along]) else (-1, 1, *near)
                hanging = (-1, 1, 0.44, 0.48) if upper else (-1, 1, -0.48, -0.44)
                offsets.append(
                    (
                        _tape_place(faces[lid], lid, across, beside),
                        _tape_place(faces[end], end, across, hanging),
                    )
                )
    flat, hung = np.array(offsets).T
    assert hung == pytest.approx(flat, abs=0.0016)
    # Tape in the very middle would prove nothing.
    assert np.abs(flat).max() > 0.004


@pytest.mark.parametrize("size", [(0.4, 0.3, 0.25), (0.2, 0.15, 0.1), (0.3, 0.3, 0.6)])
@pytest.mark.parametrize("surface", ["cardboard", "plastic", "shrink_film", "kraft_paper"])
def test_optical_flow_finds_its_way_on_every_face(size, surface):
    """Bar: at 2.3 mm a pixel with noise of one level, half of 15 or more corners are found to 0.1 px."""
    shift, rng = np.array([0.4, -0.3]), np.random.default_rng(1)
    for face in carton_faces(_package(size, surface=surface), seed=2):
        seen = []
        for moved in (np.zeros(2), shift):
            matrix = np.array([[0.614, 0.0, moved[0]], [0.0, 0.614, moved[1]]])
            extent = (int(0.614 * face.shape[1]) - 2, int(0.614 * face.shape[0]) - 2)
            soft = cv2.GaussianBlur(face, (0, 0), 0.7)
            grey = cv2.cvtColor(
                cv2.warpAffine(soft, matrix, extent, flags=cv2.INTER_CUBIC), cv2.COLOR_RGB2GRAY
            )
            seen.append(np.clip(grey + rng.normal(0.0, 1.0, grey.shape), 0, 255).astype(np.uint8))
        corners = cv2.goodFeaturesToTrack(seen[0][4:-4, 4:-4], 80, 0.003, 4) + np.float32(4.0)
        found, status, _ = cv2.calcOpticalFlowPyrLK(*seen, corners, None, winSize=(15, 15))
        errors = np.linalg.norm((found - corners)[status == 1].reshape(-1, 2) - shift, axis=1)
        assert len(errors) >= 15
        assert np.median(errors) < 0.1


def test_a_carton_is_drawn_within_40_ms():
    carton_faces(_package((0.4, 0.3, 0.3)), seed=1)
    spent = []
    for name in range(8):
        start = time.thread_time()
        carton_faces(_package((0.4, 0.3, 0.3), name=f"c{name}"), seed=1)
        spent.append(time.thread_time() - start)
    assert min(spent) < 0.040


def test_grain_runs_along_the_width():
    for material in (surfaces.wood, surfaces.steel):
        grey = material(0.8, 0.2, seed=3).astype(float).mean(axis=2)
        assert np.abs(np.diff(grey, axis=0)).mean() > 2.0 * np.abs(np.diff(grey, axis=1)).mean()


def test_folds_close_around_the_load_and_stand_upright():
    heights = surfaces.fold_heights(3.0, 1.0, seed=2, pixels_per_m=400.0)
    assert heights.dtype == np.float32
    steps = np.abs(np.diff(heights, axis=1))
    # The step over the border is a step like any other.
    assert np.abs(heights[:, 0] - heights[:, -1]).mean() < 1.5 * np.percentile(steps.mean(axis=0), 95)
    assert steps.mean() > 4.0 * np.abs(np.diff(heights, axis=0)).mean()
    assert 1.0e-4 < heights.std() < 2.0e-3


@pytest.mark.parametrize("dictionary", MARKER_DICTIONARIES)
@pytest.mark.parametrize("size", [50, 80, 137, 400])
def test_tags_are_detected_at_their_corners(dictionary, size):
    sheet = tag_sheet(dictionary, 7, size)
    assert sheet.shape == (size, size, 3)
    margin = 30
    scene = cv2.copyMakeBorder(sheet, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=(96, 96, 96))
    tags = cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, "DICT_" + dictionary.replace("apriltag", "APRILTAG"))
    )
    corners, numbers, _ = cv2.aruco.ArucoDetector(tags).detectMarkers(scene)
    assert numbers.ravel().tolist() == [7]
    # A picture of n pixels spans -0.5 to n - 0.5; the quiet zone is a tenth of the sheet.
    low, high = margin - 0.5 + 0.1 * size, margin - 0.5 + 0.9 * size
    expected = [[low, low], [high, low], [high, high], [low, high]]
    assert corners[0][0] == pytest.approx(np.array(expected), abs=1.0)


@pytest.mark.parametrize("size", [32, 65, 200])
def test_quadrant_targets_meet_in_the_middle(size):
    target = quadrant_target(size)[:, :, 0]
    assert np.array_equal(target, target[::-1, ::-1])
    assert np.array_equal(target, target.T)
    near, far = round(0.35 * size), round(0.65 * size)
    assert [target[near, near], target[far, far], target[near, far], target[far, near]] == [0, 0, 255, 255]
    middle = np.array([[[0.5 * size, 0.5 * size]]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1.0e-4)
    found = cv2.cornerSubPix(target, middle, (5, 5), (-1, -1), criteria)
    assert found.ravel() == pytest.approx([0.5 * (size - 1)] * 2, abs=0.02)


@pytest.mark.parametrize(
    ("field", "call"),
    [
        ("pixels_per_m", lambda: carton_faces(_package((0.4, 0.3, 0.2)), seed=0, pixels_per_m=0.0)),
        ("pixels_per_m", lambda: surfaces.wood(1.0, 0.1, seed=0, pixels_per_m=float("nan"))),
        ("width_m", lambda: surfaces.fold_heights(-1.0, 0.1, seed=0)),
        ("dictionary", lambda: tag_sheet("aruco_4x4", 0, 100)),
        ("tag", lambda: tag_sheet("apriltag_16h5", 30, 100)),
        ("size_px", lambda: tag_sheet("apriltag_36h11", 0, 19)),
        ("size_px", lambda: quadrant_target(4)),
    ],
)
def test_bad_input_is_refused_by_name(field, call):
    with pytest.raises(RefusedInput) as refused:
        call()
    assert refused.value.field == field
