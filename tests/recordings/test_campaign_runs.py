"""Campaigns leave the same bytes whatever happens to their processes, their disk and their files on the way."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from config.errors import RefusedInput
from recordings.campaigns.driver import DiskFull, Standing
from recordings.campaigns.one_test import Done, Task, run_one
from recordings.campaigns.store import CampaignFolder, read_labels, test_folder
from recordings.campaigns.workers import TRIES, ProcessWorkers
from tests.recordings.tiny_campaign import (
    CAMERA,
    SCENE,
    TESTS,
    digest_on_disk,
    finished,
    run,
    tasks,
    tiny,
    wait_until,
)  # fmt: skip

FILM = {"material": "stretch_film_20", "turns": {"bottom": 2, "middle": 2, "top": 2}}
SCHEMES = (
    "eur_brick_600x400.pally.json", "eur_pinwheel_500x300.pally.json", "eur_row_600x200.pally.json",
    "eur_split_block_390x260.pally.json", "eur_split_row_480x320.pally.json", "eur_columns_600x400.nist.xml",
    "eur_crossed_600x300.nist.xml", "eur_heavy_400x200.nist.xml", "eur_tall_400x400.stackbuilder.xml",
)  # fmt: skip


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign as one worker makes it without a stop."""
    out = tmp_path_factory.mktemp("reference") / "tiny"
    standing = run(out, ProcessWorkers(1))
    assert (standing.done, standing.new, standing.refused) == (TESTS, TESTS, 0)
    return out


def same_as(reference: Path, out: Path) -> None:
    assert (out / "labels.parquet").read_bytes() == (reference / "labels.parquet").read_bytes()
    assert finished(out) == finished(reference)
    for label in read_labels(out):
        assert digest_on_disk(out, label.number) == label.bag_sha256
        assert label.pictures == CAMERA["pictures"]
    assert not list(out.rglob("*.part"))


def test_two_workers_leave_what_one_leaves(reference: Path, tmp_path: Path) -> None:
    run(tmp_path / "two", ProcessWorkers(2))
    same_as(reference, tmp_path / "two")
    assert {label.verdict for label in read_labels(reference)} == {"pass", "fail"}


def test_killed_driver_is_gone_on_with(reference: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "tests.recordings.tiny_campaign", str(out), "2"]
    with subprocess.Popen(command, cwd=Path(__file__).parents[2]) as driver:
        wait_until(lambda: len(finished(out)) >= 3, "three tests")
        workers = children(driver.pid)
        driver.kill()
    # The workers notice, and end too; what they had on the way is lost.
    assert len(workers) >= 2
    wait_until(lambda: not any(map(is_running, workers)), "the end of the workers")
    kept = finished(out)
    assert 3 <= len(kept) < TESTS

    cut = next((test_folder(out, kept[0]) / "bag").glob("*.mcap"))
    os.truncate(cut, cut.stat().st_size // 2)
    half_done = out / "tests" / ".00003.part" / "bag"
    half_done.mkdir(parents=True)
    (half_done / "bag_0.mcap").write_bytes(b"half")
    made_at = {number: test_folder(out, number).stat().st_mtime_ns for number in kept}

    standing = run(out, ProcessWorkers(1))
    assert standing.new == TESTS - len(kept) + 1
    again = {number for number in kept if test_folder(out, number).stat().st_mtime_ns != made_at[number]}
    assert again == {kept[0]}
    same_as(reference, out)


def test_killed_worker_takes_nothing_with_it(reference: Path, tmp_path: Path) -> None:
    workers, killed = ProcessWorkers(2), []

    def kill_one(standing: Standing) -> None:
        if standing.done == 2 and not killed:
            killed.append(workers.processes[0])
            os.kill(killed[0], signal.SIGKILL)

    standing = run(tmp_path / "killed", workers, on_progress=kill_one)
    assert killed
    assert (standing.done, standing.refused) == (TESTS, 0)
    same_as(reference, tmp_path / "killed")


class DeadlyTest:
    """One worker that dies whenever it has one certain test."""

    def __init__(self, number: int) -> None:
        self.number, self.kills = number, 0
        self._workers, self._running = ProcessWorkers(1), -1

    @property
    def count(self) -> int:
        return self._workers.count

    def submit(self, task: Task) -> None:
        self._running = task.number
        self._workers.submit(task)

    def finished(self, timeout_s: float) -> list[Done]:
        # The test is submitted again from within, as long as it is not given up.
        if self._running == self.number and self.kills < TRIES:
            os.kill(self._workers.processes[0], signal.SIGKILL)
            self.kills += 1
        return self._workers.finished(timeout_s)

    def close(self) -> None:
        self._workers.close()


def test_deadly_test_is_given_up(reference: Path, tmp_path: Path) -> None:
    out, workers = tmp_path / "deadly", DeadlyTest(2)
    standing = run(out, workers)
    assert (workers.kills, standing.done, standing.refused) == (TRIES, TESTS, 1)
    refused = json.loads((out / "refused.json").read_text())
    assert [draw["number"] for draw in refused] == [2]
    assert refused[0]["reason"] == "given up after 3 tries: its process ended with code -9"
    # The next draw takes its place.
    assert finished(out) == [0, 1, 3, 4, TESTS]
    alike = {label.number: label.to_json() for label in read_labels(reference)}
    assert all(label.to_json() == alike[label.number] for label in read_labels(out)[:-1])


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    options = ["-t", "tmpfs", "-o", "size=2G,nr_inodes=1000", "tmpfs"]
    if os.geteuid() != 0 or subprocess.run(["mount", *options, disk], capture_output=True).returncode != 0:
        pytest.skip("may not mount a disk")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_full_disk_ends_it_and_room_lets_it_go_on(reference: Path, small_disk: Path) -> None:
    out = small_disk / "tiny"

    def remount(options: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{options}", small_disk], check=True)

    # Not one file more after the second test; then hardly any room after the next.
    for full, at in (("nr_inodes=20", 2), ("size=100M", 3)):

        def fill(standing: Standing, options: str = full, at: int = at) -> None:
            if standing.done == at:
                remount(options)

        with pytest.raises(DiskFull, match="finished tests are whole") as stop:
            run(out, ProcessWorkers(1), on_progress=fill)
        assert stop.value.exit_code == 3
        assert finished(out) == list(range(2 if at == 2 else 4))
        for label in read_labels(out):
            assert digest_on_disk(out, label.number) == label.bag_sha256
        remount("size=2G,nr_inodes=1000")

    assert run(out, ProcessWorkers(1)).new == TESTS - 4
    same_as(reference, out)


def test_disk_limit_is_kept_and_can_be_raised(reference: Path, tmp_path: Path) -> None:
    out = tmp_path / "limit"
    with pytest.raises(RefusedInput, match=r"disk_gb = 0\.001: at least"):
        run(out, ProcessWorkers(1), tiny(disk_gb=0.001))
    assert finished(out) == []
    with CampaignFolder(out, tiny(disk_gb=1.0)) as folder:
        assert folder.labels == {}


def test_bad_palletising_file_stops_no_other(tmp_path: Path) -> None:
    (tmp_path / "broken.pally.json").write_text('{"name": "half a fi')
    loads = [{"file": file, "layers": [1, 1]} for file in (*SCHEMES[:4], "broken.pally.json", *SCHEMES[4:])]
    grid = tiny(mode="grid", tests=None, loads=loads, scene=SCENE, vary={}, friction={})
    out = tmp_path / "ten"
    standing = run(out, ProcessWorkers(2), grid, base=tmp_path)
    assert (standing.done, standing.refused) == (9, 1)
    refused = json.loads((out / "refused.json").read_text())
    assert [(draw["number"], draw["factors"]["scheme"]) for draw in refused] == [(4, "broken")]
    assert "not valid JSON" in refused[0]["reason"]
    assert "\n" not in refused[0]["reason"]
    assert {label.factors["scheme"] for label in read_labels(out)} == {file.split(".")[0] for file in SCHEMES}


def test_folder_belongs_to_one_run_of_one_campaign(reference: Path, tmp_path: Path) -> None:
    with (
        CampaignFolder(reference, tiny()),
        pytest.raises(RefusedInput, match="in use by another run"),
    ):
        CampaignFolder(reference, tiny())
    with pytest.raises(RefusedInput, match="holds another campaign") as other:
        CampaignFolder(reference, tiny(seed=1))
    assert "\n" not in str(other.value)
    for torn in ("", "[]", '{"format": 1'):
        (tmp_path / "torn").mkdir(exist_ok=True)
        (tmp_path / "torn" / "campaign.json").write_text(torn)
        with pytest.raises(RefusedInput, match="another version"):
            CampaignFolder(tmp_path / "torn", tiny())
    shutil.rmtree(tmp_path / "torn")
    (tmp_path / "letter.txt").write_text("mine")
    with pytest.raises(RefusedInput, match="something else"):
        CampaignFolder(tmp_path, tiny())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["letter.txt"]


def test_finished_campaign_runs_nothing(reference: Path) -> None:
    before = (reference / "labels.parquet").read_bytes()
    standing = run(reference, ProcessWorkers(1))
    assert (standing.done, standing.new) == (TESTS, 0)
    assert (reference / "labels.parquet").read_bytes() == before


def test_what_ran_before_leaves_no_trace(reference: Path) -> None:
    """First in a process or last, with film, pictures and compiled kernels: a test's bag is the same."""
    load = [{"file": SCHEMES[0], "layers": [1, 1]}]
    filmed = tasks(tiny(scene={**SCENE, "camera": CAMERA, "wrap": FILM}, loads=load), 1)[0]
    first = run_one(filmed)
    in_turn = tasks(tiny(), TESTS)[::-1]
    workers = ProcessWorkers(1)
    try:
        done = [run_in(workers, task) for task in (*in_turn, filmed)]
    finally:
        workers.close()
    assert done[-1].bag == first.bag
    assert done[-1].label == first.label
    assert [one.label for one in done[-2::-1]] == read_labels(reference)


def run_in(workers: ProcessWorkers, task: Task) -> Done:
    workers.submit(task)
    return workers.finished(60.0)[0]


def children(process: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def is_running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
