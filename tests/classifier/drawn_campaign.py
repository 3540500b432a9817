"""A campaign's folder whose bags hold drawn pictures: a square stands still where the test passed, and slides where not."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from classifier.examples import Example
from msgs_adapters.publications import jpeg_publication, report_publication
from recordings.bag_writer import BagWriter
from recordings.campaigns.labels import Label
from recordings.campaigns.one_test import bag_digest
from recordings.campaigns.store import test_folder
from sim_core.camera.jpeg import jpeg_of

PICTURES = 5


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


def write_bag(folder: Path, shown: list[np.ndarray], *, verdict: str | None = None) -> str:
    """A bag with pictures, and with a judge's report where there is a verdict; gives its digest."""
    with BagWriter(folder) as writer:
        for index, picture in enumerate(shown):
            publication = jpeg_publication(1_000_000_000 + 40_000_000 * index, jpeg_of(picture))
            name = writer.add_topic(publication.topic)
            writer.write(name, publication.payload, log_time_ns=publication.stamp_ns)
        if verdict is not None:
            said = report_publication(2_000_000_000, json.dumps({"verdict": verdict}))
            writer.write(writer.add_topic(said.topic), said.payload, log_time_ns=said.stamp_ns)
    return bag_digest({path.name: path.read_bytes() for path in folder.iterdir()})


def drawn_campaign(folder: Path, *, tests: int, schemes: int = 4, every_third: str = "fail") -> Path:
    """Fails and passes by turns; schemes by turns, too."""
    (folder / "tests").mkdir(parents=True)
    (folder / "campaign.json").write_text(json.dumps({"campaign": {"name": "drawn"}}))
    for number in range(tests):
        verdict = "pass" if number % 3 == 1 else every_third if number % 3 == 2 else "fail"
        own = test_folder(folder, number)
        own.mkdir()
        bag = own / "bag"
        count = PICTURES + number % 2
        digest = write_bag(bag, pictures(number, slides=verdict == "fail", count=count), verdict=verdict)
        told = label(number, verdict, f"scheme{number // 3 % schemes}", bag_sha256=digest)
        (own / "label.json").write_text(told.to_json())
    return folder
