"""A scene with a camera: the same pictures from a run, a graph and a recording drawn anew, and what is refused."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from config.scene_file import find_scene, read_scene
from msgs_adapters.camera_payloads import calibration_from_payload
from recordings.bag_pictures import pictures_of_bag
from recordings.bag_reader import BagReader
from sim_core.camera.view import view_of
from tests.ros_nodes.graph import environment, missing_of, pallet_twin, payloads
from tests.torn_scene import TORN

SMALL = {"width_px": 160, "height_px": 90, "rate_hz": 15}
CAMERA_TOPICS = ("camera/camera_info", "camera/image_raw/compressed")


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of a load whose film tears, seen by a small camera."""
    folder = tmp_path_factory.mktemp("camera")
    (folder / "scene.json").write_text(json.dumps({**TORN, "camera": SMALL}))
    done = pallet_twin("run", "scene.json", "--out", "run", "--no-estimate", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_run_leaves_pictures_calibration_and_video(ran: Path) -> None:
    scene = read_scene(ran / "scene.json")
    bag = ran / "run" / "bag"
    frames = payloads(bag, "/twin/packages/poses")
    infos, jpegs = (payloads(bag, f"/twin/{name}") for name in CAMERA_TOPICS)
    assert len(infos) == len(jpegs) == -(-len(frames) // (240 // 15))
    calibration, view = calibration_from_payload(infos[0]), view_of(scene)
    np.testing.assert_array_equal(calibration.matrix, view.matrix)
    np.testing.assert_array_equal(calibration.distortion, view.distortion)
    with BagReader(bag) as reader:
        pictures = list(pictures_of_bag(reader))
    assert {picture.pixels.shape for picture in pictures} == {(90, 160, 3)}
    steps = {b.stamp_ns - a.stamp_ns for a, b in pairwise(pictures)}
    assert all(abs(step - 1e9 / 15) < 2 for step in steps)
    # The load moves through the picture.
    assert np.abs(pictures[0].pixels.astype(int) - pictures[-1].pixels).max() > 60
    report = json.loads((ran / "run" / "report.json").read_text())
    assert report["camera"]["pictures"] == len(pictures)
    assert report["camera"]["distance_m"] == pytest.approx(4.0)
    page = (ran / "run" / "report.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 3 and page.count("data:video/mp4;base64,") == 1


def test_video_shows_every_picture(ran: Path) -> None:
    import av

    with av.open(str(ran / "run" / "video.mp4")) as video:
        shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        assert float(video.streams.video[0].average_rate) == 15.0
    with BagReader(ran / "run" / "bag") as reader:
        pictures = list(pictures_of_bag(reader))
    assert len(shown) == len(pictures)
    assert np.abs(shown[0].astype(int) - pictures[0].pixels).mean() < 6.0


def test_graph_records_the_pictures_of_a_run(ran: Path) -> None:
    done = pallet_twin("up", "scene.json", "--out", "up", "--no-estimate", cwd=ran, env=environment())
    assert done.returncode == 0, done.stderr
    for topic in (*CAMERA_TOPICS, "packages/poses", "scene"):
        graph, headless = (payloads(ran / name / "bag", f"/twin/{topic}") for name in ("up", "run"))
        assert graph and graph == headless, topic
    assert list(missing_of(ran / "up" / "bag")) == []
    assert "data:video/mp4" in (ran / "up" / "report.html").read_text()
    # Pictures that were drawn before are shown again, to the byte.
    again = pallet_twin(
        "up", "scene.json", "--pictures", "run/bag", "--pace", "real", "--set", "camera.record=raw", "--out", "again",
        "--no-estimate", cwd=ran, env=environment(),
    )  # fmt: skip
    assert again.returncode == 0, again.stderr
    recorded = []
    for name in ("run", "again"):
        with BagReader(ran / name / "bag") as reader:
            recorded.append([picture.pixels for picture in pictures_of_bag(reader)])
    assert len(recorded[0]) == len(recorded[1])
    assert all(np.array_equal(a, b) for a, b in zip(*recorded, strict=True))
    assert list(missing_of(ran / "again" / "bag")) == []


def test_recording_is_drawn_anew_to_the_byte_and_from_elsewhere(ran: Path) -> None:
    done = pallet_twin("render", "run/bag", "--out", "same", "--json", cwd=ran)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["pictures"] == len(payloads(ran / "run" / "bag", f"/twin/{CAMERA_TOPICS[1]}"))
    with BagReader(ran / "run" / "bag") as old, BagReader(ran / "same" / "bag") as new:
        assert {name: t.message_count for name, t in old.topics.items()} == {
            name: t.message_count for name, t in new.topics.items()
        }
        for name in old.topics:
            assert [m.payload for m in old.messages([name])] == [m.payload for m in new.messages([name])], (
                name
            )
    other = pallet_twin("render", "run/bag", "--out", "far", "--set", "camera.distance_m=9", cwd=ran)
    assert other.returncode == 0, other.stderr
    with BagReader(ran / "far" / "bag") as reader:
        (message,) = reader.messages(["/twin/scene"])
    assert json.loads(message.decode().data)["camera"]["distance_m"] == 9
    calibration = calibration_from_payload(payloads(ran / "far" / "bag", "/twin/camera/camera_info")[0])
    assert calibration.matrix[0, 0] > 1.5 * view_of(read_scene(ran / "scene.json")).matrix[0, 0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "block_slip", "--set", "camera.rate_hz=7"], "camera.rate_hz 7 must divide sampling.poses_hz 240"),
        (["run", "block_slip", "--set", "camera.width_px=63"], "camera.width_px = 63"),
        (["run", "block_slip", "--set", "camera.shutter_s=0.05"], "at most one picture interval"),
        (["run", "block_slip", "--set", "camera.distortion=[9,0,0,0,0]"], "camera.distortion.0 = 9"),
        (["run", "block_slip", "--set", "camera.distortion=[-4,0,0,0,0]"], "it folds the picture"),
        (["run", "block_slip", "--set", "camera.position_m=[0,0,0.1]"], "camera.position_m"),
        (["run", "block_slip", "--set", "camera={}", "--video", "here.avi"], "--video = here.avi: must end in .mp4"),
        (["run", "block_slip", "--video", "here.mp4"], "needs a camera in the scene"),
        (["up", "block_slip", "--pictures", "nowhere"], "--pictures = nowhere: needs a camera"),
        (["render", "nowhere"], "nowhere"),
    ],
)  # fmt: skip
def test_what_the_camera_cannot_be_is_refused_in_a_line(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    done = pallet_twin(*arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_recordings_other_parts_stay_as_they_are(ran: Path, tmp_path: Path) -> None:
    done = pallet_twin("render", str(ran / "run" / "bag"), "--set", "sled.level_g=0.1", cwd=tmp_path)
    assert done.returncode == 2 and "must be of the camera" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_scene_without_a_camera_loads_no_renderer(tmp_path: Path) -> None:
    probe = (
        "import sys; sys.argv = ['pallet-twin', 'run', 'block_slip', '--out', 'o', '--no-estimate']\n"
        "from ros_nodes.entry import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('loaded', [m for m in ('cv2', 'vtkmodules', 'pyvista', 'av', 'sim_core.camera') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", probe], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.strip().endswith("loaded []"), done.stdout + done.stderr


@pytest.mark.parametrize("name", ["eur_camera", "eur_camera_markers"])
def test_shipped_cameras_see_load_and_sled_over_the_whole_travel(name: str) -> None:
    from sim_core.camera.layout import markers_of, side_of, targets_of
    from sim_core.geometry import box_corners, yaw_quaternion

    scene = read_scene(find_scene(name))
    view, side = view_of(scene), side_of(scene)
    corners = box_corners(
        np.array([p.position_m for p in scene.packages]),
        np.array([yaw_quaternion(p.yaw_deg) for p in scene.packages]),
        0.5 * np.array([p.size_m for p in scene.packages]),
    ).reshape(-1, 3)
    for travel in side.travel_m:
        pixels = view.project(np.vstack((corners, targets_of(scene))) + travel * side.right)
        assert (pixels > 0).all() and (pixels < [view.width - 1, view.height - 1]).all()
    assert len(markers_of(scene)) == (36 if name == "eur_camera_markers" else 0)
