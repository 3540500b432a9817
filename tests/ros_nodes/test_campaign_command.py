"""``pallet-twin campaign`` and ``verify`` as a user calls them: results, refusals, exit codes, an interrupt."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

TINY = {
    "name": "tiny",
    "tests": 4,
    "seed": 5,
    "scene": {
        "name": "x",
        "load": {},
        "sled": {"profile": "eumos", "level_g": 0.4, "plateau_s": 0.3, "deceleration_g": 0.2},
        "camera": {"width_px": 64, "height_px": 64, "pictures": 3, "light": {"shadows": False}},
    },
    "loads": [{"file": "eur_brick_600x400.pally.json", "layers": [1, 1]}],
    "vary": {"sled.level_g": [0.3, 0.8], "camera.seed": {"from": 0, "to": 99, "whole": True}},
    "friction": {"cardboard/wood": {"from": 0.2, "to": 0.6}},
}


def call(*args: str, ok: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", "ros_nodes.cli", *args], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == ok, done.stdout + done.stderr
    return done


def written(folder: Path, **changes: object) -> str:
    path = folder / "tiny.json"
    path.write_text(json.dumps({**TINY, **changes}))
    return str(path)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    told = json.loads(
        call("campaign", written(folder), "--out", str(folder / "out"), "--workers", "1", "--json").stdout
    )
    assert (told["done"], told["new"], told["refused"]) == (4, 4, 0)
    assert told["passes"] + told["fails"] + told["unresolved"] == 4
    return folder / "out"


def test_every_test_is_a_bag_and_a_row(finished):
    rows = pq.read_table(finished / "labels.parquet").to_pylist()
    assert [row["number"] for row in rows] == [0, 1, 2, 3]
    for row in rows:
        assert row["pictures"] == 3 and row["factor.sled.level_g"] in (0.3, 0.8)
        assert row["success"] == {"pass": True, "fail": False, "unresolved": None}[row["verdict"]]
        assert (finished / "tests" / f"{row['number']:05d}" / "bag" / "metadata.yaml").is_file()
        # Slow boards slip and fast ones don't: what decides is friction against level.
        if row["factor.friction cardboard/wood"] > row["factor.sled.level_g"] + 0.05:
            assert row["verdict"] == "pass"
    costs = pq.read_table(finished / "costs.parquet").to_pylist()
    assert [cost["number"] for cost in costs] == [0, 1, 2, 3] and all(cost["wall_s"] > 0 for cost in costs)


def test_a_finished_campaign_is_not_run_again(finished):
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("label.json")}
    told = json.loads(
        call("campaign", str(finished.parent / "tiny.json"), "--out", str(finished), "--json").stdout
    )
    assert (told["done"], told["new"]) == (4, 0)
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("label.json")} == before


def test_labels_hold_against_bags_and_finer_runs(finished, tmp_path):
    told = json.loads(call("verify", str(finished), "--share", "0.5", "--json").stdout)
    assert (told["bags"], told["finer"], told["holds"]) == (4, 2, True)
    broken = tmp_path / "broken"
    shutil.copytree(finished, broken)
    label = broken / "tests" / "00002" / "label.json"
    row = json.loads(label.read_text())
    row["verdict"], row["judged"] = ("pass", "pass") if row["judged"] == "fail" else ("fail", "fail")
    label.write_text(json.dumps(row))
    bag = next((broken / "tests" / "00001" / "bag").glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[:-1] + b"x")
    told = json.loads(call("verify", str(broken), "--share", "0", "--json", ok=3).stdout)
    assert [entry["number"] for entry in told["damaged"]] == [1]
    assert [entry["number"] for entry in told["rejudged"]] == [2]


def test_a_recipe_is_drawn_to_the_same_pictures(finished, tmp_path):
    call("campaign", written(tmp_path, video="recipe"), "--out", str(tmp_path / "out"), "--at-most", "1")
    bag = tmp_path / "out" / "tests" / "00000" / "bag"
    call("render", str(bag), "--out", str(tmp_path / "drawn"))
    from recordings.bag_pictures import pictures_of_bag
    from recordings.bag_reader import BagReader

    def jpegs(path):
        with BagReader(path) as reader:
            return [picture.jpeg for picture in pictures_of_bag(reader)]

    drawn = jpegs(tmp_path / "drawn" / "bag")
    assert len(drawn) == 3 and drawn == jpegs(finished / "tests" / "00000" / "bag")


def test_a_bad_file_is_named_and_the_rest_done(tmp_path):
    (tmp_path / "bad.json").write_text("{}")
    file = written(tmp_path, loads=[*TINY["loads"], {"file": "bad.json"}], tests=2)
    done = call("campaign", file, "--out", str(tmp_path / "out"), "--workers", "1", ok=2)
    assert "tests   2 of 2" in done.stdout
    assert done.stderr.count("skipped bad.json") == 1


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (["campaign", "nothing"], "no such file, and no shipped campaign"),
        (["campaign", "smoke", "--set", "tests=0"], "tests = 0"),
        (["campaign", "smoke", "--set", "disk_gb=0.001"], "disk_gb = 0.001"),
        (["verify", "nowhere"], "must be the folder of a campaign"),
    ],
)
def test_refusals_are_one_line(args, told, tmp_path):
    extra = ["--out", str(tmp_path / "out")] if args[0] == "campaign" else []
    done = call(*args, *extra, ok=2)
    assert told in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_a_check_runs_nothing(tmp_path):
    told = json.loads(call("campaign", "smoke", "--check", "--json").stdout)
    assert told["tests"] == 8 and told["checked"] == 100 and not told["bad_files"]


def test_an_interrupt_leaves_whole_tests_and_their_table(tmp_path):
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "ros_nodes.cli",
        "campaign",
        written(tmp_path, tests=500),
        "--workers",
        "2",
    ]
    process = subprocess.Popen([*command, "--out", str(out)], stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60.0
        while len(list(out.glob("tests/[0-9]*"))) < 3 and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 130
    finally:
        process.kill()
        process.wait()
    rows = pq.read_table(out / "labels.parquet").to_pylist()
    assert len(rows) == len(list(out.glob("tests/[0-9]*"))) >= 3
    assert not list(out.glob("tests/.*"))
