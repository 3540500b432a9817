"""A campaign's folder whose bags hold drawn pictures: a square stands still where the test passed, and slides where not.

Poses say the same of the upper one of two boxes, 1 m high together.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from classifier.examples import Example
from config.scene_file import validate_scene
from msgs_adapters.publications import frame_publication, jpeg_publication, report_publication
from recordings.bag_writer import BagWriter
from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import bag_digest
from recordings.campaigns.store import test_folder
from recordings.test_bag import attach_scene
from sim_core.camera.jpeg import jpeg_of
from sim_core.frames import PoseFrame

PICTURES = 5
SLID_MM = 20.0
"""From picture to picture, where the test failed; the permanent limit is 50 mm."""
START_NS, PICTURE_NS, POSE_NS = 1_000_000_000, 40_000_000, 10_000_000
BOX = {"size_m": [0.4, 0.4, 0.5], "mass_kg": 5.0}
SCENE = validate_scene(
    {
        "name": "two_boxes",
        "load": {
            "packages": [
                {"id": name, "position_m": [0.0, 0.0, z], **BOX}
                for name, z in (("low", 0.25), ("high", 0.75))
            ]
        },
        "pallet": None,
        "surfaces": {
            "pairs": [
                {"between": ["cardboard", "sled"], "friction": 0.5},
                {"between": ["cardboard", "cardboard"], "friction": 0.5},
            ]
        },
        "sled": {"profile": "eumos", "level_g": 0.3},
    }
)


def label(number: int, verdict: str, scheme: str, *, bag_sha256: str = "", **changes: Any) -> Label:
    values: dict[str, Any] = {
        "number": number, "weight": 1.0, "factors": {"scheme": scheme}, "packages": 1, "mass_kg": 1.0,
        "height_m": 1.0, "verdict": verdict, "judged": verdict, "first_rule": None, "first_time_s": None,
        "first_package": None, "first_corner": None, "first_height_m": None, "states": {}, "worst_mm": {},
        "margin_mm": {}, "error_mm": {}, "estimate_problem": None, "ended_by": None, "engine": "bullet",
        "time_step_s": 0.001, "penetration_mm": 0.0, "energy_residual": 0.0, "simulated_s": 1.0,
        "pictures": PICTURES, "scene_sha256": "", "bag_sha256": bag_sha256, "bag_bytes": 0,
    }  # fmt: skip
    return Label(**{**values, **changes})


def example(number: int, verdict: str, scheme: str) -> Example:
    return Example(number, Path(), scheme, verdict == "pass", label(number, verdict, scheme))


def pictures(number: int, *, slides: bool, count: int = PICTURES) -> list[np.ndarray]:
    """Shape [48, 64, 3] each; another background for each number."""
    rng = np.random.default_rng(number)
    background = rng.integers(40, 90, (48, 64, 3), dtype=np.uint8)
    found = []
    for index in range(count):
        picture = background.copy()
        left = 8 + (10 * index if slides else 0)
        picture[12:36, left : left + 14] = 220
        found.append(picture)
    return found


def poses(count: int, *, slid_mm: float) -> list[PoseFrame]:
    """Four to a picture: the upper box goes by so much from picture to picture."""
    found = []
    for index in range(4 * (count - 1) + 1):
        x = 0.001 * slid_mm * index * POSE_NS / PICTURE_NS
        positions = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.25], [x, 0.0, 0.75]])
        turns = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
        found.append(PoseFrame(index, START_NS + index * POSE_NS, positions, turns))
    return found


def write_bag(
    folder: Path, shown: list[np.ndarray], *, verdict: str | None = None, slid_mm: float | None = None
) -> str:
    """A bag with pictures; a judge's report where there is a verdict, scene and poses where it slid; gives its digest."""
    said = [
        jpeg_publication(START_NS + PICTURE_NS * index, jpeg_of(picture))
        for index, picture in enumerate(shown)
    ]
    if slid_mm is not None:
        said += [frame_publication(frame) for frame in poses(len(shown), slid_mm=slid_mm)]
    if verdict is not None:
        said.append(report_publication(2_000_000_000, json.dumps({"verdict": verdict})))
    with BagWriter(folder) as writer:
        for publication in sorted(said, key=lambda one: one.stamp_ns):
            name = writer.add_topic(publication.topic)
            writer.write(name, publication.payload, log_time_ns=publication.stamp_ns)
        if slid_mm is not None:
            attach_scene(writer, SCENE)
    return bag_digest({path.name: path.read_bytes() for path in folder.iterdir()})


def drawn_campaign(
    folder: Path, *, tests: int, schemes: int = 4, every_third: str = "fail", posed: bool = True
) -> Path:
    """Fails and passes by turns; schemes by turns, too; bags with poses, or without."""
    (folder / "tests").mkdir(parents=True)
    (folder / "campaign.json").write_text(json.dumps({"campaign": {"name": "drawn"}}))
    for number in range(tests):
        verdict = "pass" if number % 3 == 1 else every_third if number % 3 == 2 else "fail"
        own = test_folder(folder, number)
        own.mkdir()
        bag = own / "bag"
        count = PICTURES + number % 2
        slides = verdict == "fail"
        shown = pictures(number, slides=slides, count=count)
        slid_mm = None if not posed else SLID_MM if slides else 0.0
        digest = write_bag(bag, shown, verdict=verdict, slid_mm=slid_mm)
        told = label(number, verdict, f"scheme{number // 3 % schemes}", bag_sha256=digest)
        (own / "label.json").write_text(told.to_json())
    return folder
