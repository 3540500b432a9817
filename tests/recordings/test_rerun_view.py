"""A bag as rerun shows it: what the adapter draws of it, the page in a browser, and the bag opened as it is."""

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from config.errors import BrokenRecording, RefusedInput
from msgs_adapters.topics import PACKAGES_POSES
from recordings.judge_bag import judge_bag
from recordings.rerun_page import DataServer, ViewerPage, free_port, save_bag
from recordings.rerun_view import RerunView, view_bag
from tests.recordings.headless_chromium import CHROMIUM, Picture, chromium
from tests.recordings.rerun_tools import drawn, rerun
from tests.recordings.rrd_rows import Rows, moving, rows_of
from tests.ros_nodes.graph import counts, pallet_twin, payloads
from tests.torn_scene import TORN


@pytest.fixture(autouse=True, scope="module")
def strict() -> Iterator[None]:
    """What rerun would only warn of fails."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A load whose film tears, seen by a small camera."""
    folder = tmp_path_factory.mktemp("torn")
    camera = {"width_px": 320, "height_px": 180, "rate_hz": 15}
    scene = {**TORN, "camera": camera, "accelerometer": {}}
    (folder / "scene.json").write_text(json.dumps(scene))
    done = pallet_twin("run", "scene.json", "--out", "out", "--no-estimate", "--no-page", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "out" / "bag"


@pytest.fixture(scope="module")
def saved(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("saved") / "view.rrd"
    save_bag(bag, file)
    return file


@pytest.fixture(scope="module")
def rows(saved: Path) -> Rows:
    return rows_of(saved)


def test_load_moves_at_sixty_hertz_and_rests_where_the_bag_ends(bag: Path, rows: Rows) -> None:
    scene, judge = judge_bag(bag)
    (still,) = [values for t, values in rows["/world/sled/packages"] if t is None]
    assert np.allclose(still["Boxes3D:half_sizes"], [0.5 * np.array(p.size_m) for p in scene.packages])
    times, centres = moving(rows, "/world/sled/packages", "Boxes3D:centers")
    end_s = judge.series().times_s[-1]
    assert times[0] == 0.0 and times[-1] == pytest.approx(end_s, abs=1e-9)
    assert abs(len(times) - 60.0 * end_s) <= 2.0
    moments = {moment.name: moment.frame for moment in judge.moments()}
    assert np.allclose(centres[0], moments["settled"].positions[1:], atol=1e-6)
    assert np.allclose(centres[-1], moments["end"].positions[1:], atol=1e-6)
    _, travel = moving(rows, "/world/sled", "Transform3D:translation")
    assert travel[-1][0][0] - travel[0][0][0] > 0.5


def test_displacement_is_the_judges_in_every_frame_with_the_limits_beside_it(bag: Path, rows: Rows) -> None:
    _, judge = judge_bag(bag)
    series = judge.series(rate_hz=float("inf"))
    bands = {path for path in rows if path.startswith("/plots/displacement/band_")}
    assert bands == {f"/plots/displacement/band_{band}" for band in series.bands}
    for band, expected in zip(series.bands, series.displacement_mm, strict=True):
        times, values = moving(rows, f"/plots/displacement/band_{band}", "Scalars:scalars")
        assert np.allclose(times, series.times_s, atol=1e-8)
        assert np.array_equal(np.ravel(values), expected)
    for rule in judge.rules():
        if rule.limit_mm is not None:
            times, values = moving(rows, f"/plots/displacement/limit_{rule.rule}", "Scalars:scalars")
            assert (times[0], times[-1]) == pytest.approx((0.0, series.times_s[-1]))
            assert set(np.ravel(values)) == {rule.limit_mm}


def test_acceleration_is_in_g_along_the_travel(bag: Path, rows: Rows) -> None:
    for name, topic in (("commanded", "acceleration"), ("accelerometer", "accelerometer")):
        _, values = moving(rows, f"/plots/acceleration/{name}", "Scalars:scalars")
        assert len(values) == counts(bag)[f"/twin/sled/{topic}"]
        assert np.max(values) == pytest.approx(0.8, abs=0.03)


def test_torn_film_is_left_out_and_told(bag: Path, rows: Rows) -> None:
    _, meshes = moving(rows, "/world/sled/film", "Mesh3D:vertex_positions")
    assert len(meshes) == counts(bag)["/twin/wrap/strain"]
    assert len(meshes[-1]) < len(meshes[0])
    _, colours = moving(rows, "/world/sled/film", "Mesh3D:vertex_colors")
    assert [len(colour) for colour in colours] == [len(mesh) for mesh in meshes]
    assert max(len(set(colour)) for colour in colours) > 4
    lines = [line[0] for line in moving(rows, "/log", "TextLog:text")[1]]
    assert lines[0].startswith("torn") and lines[-1] == "verdict: fail"
    assert any(line.startswith("film: ") and "elements torn" in line for line in lines)
    assert any(line.startswith("damage: fail") and "at film" in line for line in lines)


def test_rules_change_when_the_validator_says_so(bag: Path, rows: Rows) -> None:
    times, states = moving(rows, "/rules/damage", "StateChange:state")
    assert [state[0] for state in states] == ["pass", "fail"] and times[0] < times[1]
    _, tables = moving(rows, "/rules", "TextDocument:text")
    assert len(tables) == counts(bag)["/twin/eumos/status"]
    assert "| damage | **fail** |" in tables[-1][0]


def test_every_picture_is_there_as_it_was_taken(bag: Path, rows: Rows) -> None:
    _, pictures = moving(rows, "/camera/image", "EncodedImage:blob")
    recorded = payloads(bag, "/twin/camera/image_raw/compressed")
    assert len(pictures) == len(recorded)
    assert bytes(pictures[0][0]) in recorded[0]
    ((_, pinhole),) = rows["/camera"]
    assert pinhole["Pinhole:resolution"] == [[320.0, 180.0]]


def test_file_brings_its_blueprint(saved: Path) -> None:
    (entry,) = RrdReader(saved).blueprints()
    assert entry.application_id == "pallet-twin"


def test_message_that_is_none_is_refused(bag: Path) -> None:
    scene, _ = judge_bag(bag)
    view = RerunView(scene, rr.RecordingStream("refused"))
    with pytest.raises(BrokenRecording, match="is not a PoseArray"):
        view.take(PACKAGES_POSES, b"\0\1\0\0nothing")
    for topic in view.topics:
        with pytest.raises(BrokenRecording):
            view.take(topic, b"\0\1\0\0")


def test_bag_opens_in_reruns_own_reader(bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "bag.rrd"
    rerun(tmp_path, "mcap", "convert", str(bag / "bag_0.mcap"), "-o", str(file))
    boxes, transforms = drawn(file)
    assert len(boxes) == 3 and {parent for parent, _ in transforms.values()} == {"world", "sled"}
    found: dict[tuple[str, str], int] = {}
    for chunk in RrdReader(file).stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            key = chunk.entity_path, name
            found[key] = found.get(key, 0) + batch.num_rows
    messages = counts(bag)
    pictures = messages["/twin/camera/image_raw/compressed"]
    assert found["/twin/camera/image_raw/compressed", "EncodedImage:blob"] == pictures
    assert found["/twin/camera/camera_info", "Pinhole:image_from_camera"] == pictures
    readings = [
        count
        for (path, name), count in found.items()
        if "accelerometer" in path and name == "Scalars:scalars"
    ]
    assert readings and set(readings) == {messages["/twin/sled/accelerometer"]}


def test_taken_port_is_refused() -> None:
    server = DataServer()
    try:
        deadline = time.monotonic() + 5.0
        with pytest.raises(RefusedInput, match="must be free"):
            while time.monotonic() < deadline:
                free_port(server.port)
    finally:
        server.close()


@pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium at /usr/bin/chromium")
def test_page_shows_load_film_camera_and_plots_at_first_sight(bag: Path, tmp_path: Path) -> None:
    server = DataServer()
    page = ViewerPage(server)
    try:
        view_bag(bag, server.recording("torn"))
        with chromium(tmp_path) as browser:
            browser.open(page.url)
            seen = browser.picture_once(has_everything, within_s=60.0)
            assert has_everything(seen), {name: sight(seen) for name, sight in SIGHTS.items()}
            # The page asks nobody but this host; what the viewer itself tried its policy forbade.
            places = {url.split("/")[2] for url in browser.asked.values() if url not in browser.refused}
            assert places == {page.url.split("/")[2], f"127.0.0.1:{server.port}"}
    finally:
        page.close()
        server.close()


def part(left: float, right: float, top: float, bottom: float) -> Callable[[Picture], Picture]:
    """A part of a picture, by shares of its width and height."""

    def cut(picture: Picture) -> Picture:
        height, width, _ = picture.shape
        return picture[
            round(top * height) : round(bottom * height), round(left * width) : round(right * width)
        ]

    return cut


def coloured(picture: Picture) -> float:
    """The share of clearly coloured pixels."""
    return float(np.mean(np.ptp(picture.astype(int), axis=2) > 40))


def lit(picture: Picture) -> float:
    """The share of pixels that are not background."""
    return float(np.mean(picture.max(axis=2) > 60))


def hues(picture: Picture) -> int:
    """How many clearly different colours cover half a percent each."""
    coarse = (picture // 32).reshape(-1, 3)
    strong = coarse[np.ptp(picture.reshape(-1, 3).astype(int), axis=1) > 40]
    _, number = np.unique(strong, axis=0, return_counts=True)
    return int(np.sum(number > 0.005 * len(coarse)))


LOAD = part(0.12, 0.42, 0.08, 0.62)
SIGHTS: dict[str, Callable[[Picture], float]] = {
    "load": lambda picture: coloured(LOAD(picture)) / 0.05,
    "colours of the load": lambda picture: hues(LOAD(picture)) / 3.0,
    "camera": lambda picture: lit(part(0.55, 0.99, 0.08, 0.33)(picture)) / 0.15,
    "displacement": lambda picture: coloured(part(0.56, 0.99, 0.4, 0.62)(picture)) / 0.002,
    "acceleration": lambda picture: coloured(part(0.03, 0.26, 0.69, 0.94)(picture)) / 0.005,
    "rules": lambda picture: lit(part(0.28, 0.49, 0.69, 0.94)(picture)) / 0.01,
    "rules over time": lambda picture: coloured(part(0.5, 0.72, 0.69, 0.94)(picture)) / 0.2,
    "log": lambda picture: lit(part(0.74, 0.99, 0.69, 0.94)(picture)) / 0.01,
}
"""How much of what must be seen is seen, 1 being enough."""


def has_everything(picture: Picture) -> bool:
    return all(sight(picture) >= 1.0 for sight in SIGHTS.values())
