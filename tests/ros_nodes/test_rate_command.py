"""``pallet-twin rate`` as a user runs it: certificate, variants, continued after a kill, refusals."""

import csv
import json
import os
import signal
import time
from pathlib import Path

import pytest

from tests.ros_nodes.graph import environment, pallet_twin, start

BLOCK = ("rate", "block_slip", "--set", 'sled={"profile":"eumos","level_g":0.5,"plateau_s":0.3}')
FRICTION = "surfaces.pairs.0.friction"


def test_variants_are_ranked_refused_ones_named_and_results_taken_again(tmp_path: Path) -> None:
    command = (*BLOCK, "--to", "0.4", "--vary", f"{FRICTION}=0.25,0.35,-1", "--workers", "2", "--out", "here")
    done = pallet_twin(*command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "here"
    with (out / "rating.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["rank"], row["largest_passed_g"]) for row in rows] == [("1", "0.3"), ("2", "0.2"), ("", "")]
    assert f"not tested: {FRICTION}=-1" in done.stdout
    page = (out / "rating.html").read_text()
    assert "<svg" in page and "not validation" in page
    written = {path: path.stat().st_mtime_ns for path in (out / "levels").iterdir()}
    before = {name: (out / name).read_bytes() for name in ("rating.json", "rating.csv", "rating.html")}
    again = pallet_twin(*command, "--json", cwd=tmp_path)
    assert json.loads(again.stdout)["variants"][0]["rank"] == 1 and again.stderr == ""
    # What is there is not run again, and gives the same bytes.
    assert {path: path.stat().st_mtime_ns for path in (out / "levels").iterdir()} == written
    assert {name: (out / name).read_bytes() for name in before} == before


def test_a_kill_loses_what_was_running_and_leaves_nothing_behind(tmp_path: Path) -> None:
    command = (*BLOCK, "--set", f"{FRICTION}=3", "--workers", "2", "--out", "here")
    process = start(*command, "--to", "2", cwd=tmp_path, env=environment())
    levels = tmp_path / "here" / "levels"
    deadline = time.monotonic() + 60.0
    while not list(levels.glob("*.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    workers = _descendants(process.pid)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert len(workers) >= 2
    while any(_is_alive(pid) for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(_is_alive(pid) for pid in workers)
    kept = {path: path.read_bytes() for path in levels.glob("*.json")}
    assert kept
    done = pallet_twin(*command, "--to", "0.3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert (tmp_path / "here" / "certificate.html").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--step", "0.03"), "--step = 0.03"),
        (("--to", "3"), "--to = 3"),
        (("--date", "today"), "--date = today"),
        (("--vary", "wrap.turns"), "--vary = wrap.turns"),
        (("--out", "."), "--out = ."),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, str], words: str, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("not a rating")
    done = pallet_twin(*BLOCK, *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.txt"]


def _descendants(pid: int) -> list[int]:
    """Processes below one, by Linux' process table."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
    found, layer = [], [pid]
    while layer:
        layer = [child for child, parent in parents.items() if parent in layer]
        found += layer
    return found


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
