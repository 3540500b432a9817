"""A campaign of tests that take half a second each.

``python -m tests.recordings.tiny_campaign FOLDER WORKERS`` runs it, for tests that kill the driver.
"""

import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from config.campaign import Campaign, campaign_from_raw
from recordings.campaigns.drafts import Draft, Drafts
from recordings.campaigns.driver import Standing, run_campaign
from recordings.campaigns.one_test import Task, bag_digest
from recordings.campaigns.store import CampaignFolder, test_folder
from recordings.campaigns.workers import ProcessWorkers, Workers

TESTS = 5
SCENE: dict[str, Any] = {
    "sled": {"profile": "eumos", "level_g": 0.3, "rise_s": 0.05, "plateau_s": 0.3, "deceleration_g": 0.8}
}
CAMERA = {"width_px": 80, "height_px": 64, "pictures": 5, "background": "plain"}
SMALL_LOADS = (
    {"file": "eur_brick_600x400.pally.json", "layers": [1, 2]},
    {"file": "eur_tall_400x400.stackbuilder.xml", "layers": [1, 1]},
)


def tiny(**changes: Any) -> Campaign:
    raw = {
        "name": "tiny",
        "tests": TESTS,
        "scene": {**SCENE, "camera": CAMERA},
        "loads": SMALL_LOADS,
        "vary": {"sled.level_g": {"from": 0.1, "to": 0.7}},
        "friction": {"cardboard/wood": {"from": 0.3, "to": 0.6}},
        "estimate": False,
    }
    return campaign_from_raw({**raw, **changes})


def run(
    out: Path,
    workers: Workers,
    campaign: Campaign | None = None,
    *,
    base: Path = Path(),
    on_progress: Callable[[Standing], None] | None = None,
) -> Standing:
    """Runs it, or what is missing of it; the workers end with it."""
    campaign = campaign if campaign is not None else tiny()
    with closing(workers), CampaignFolder(out, campaign) as folder:  # type: ignore[type-var]
        return run_campaign(campaign, base, folder, workers, on_progress=on_progress)


def tasks(campaign: Campaign, count: int) -> list[Task]:
    drafts = Drafts(campaign, Path())
    found = [draft for draft in map(drafts.draft, range(count)) if isinstance(draft, Draft)]
    return [Task(d.number, 1.0, d.factors, d.scene.to_json(), campaign.estimate) for d in found]


def digest_on_disk(out: Path, number: int) -> str:
    return bag_digest({path.name: path.read_bytes() for path in (test_folder(out, number) / "bag").iterdir()})


def finished(out: Path) -> list[int]:
    return sorted(int(folder.name) for folder in (out / "tests").glob("[0-9]*"))


def wait_until(holds: Callable[[], bool], what: str, *, longest_s: float = 30.0) -> None:
    until = time.monotonic() + longest_s
    while not holds():
        assert time.monotonic() < until, f"{what} did not come within {longest_s:.0f} s"
        time.sleep(0.02)


if __name__ == "__main__":
    run(Path(sys.argv[1]), ProcessWorkers(int(sys.argv[2])))
