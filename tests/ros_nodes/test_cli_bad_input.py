"""Bad input at the command line: exit code 2, one line that says what and why, and nothing written."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from config.errors import RefusedInput
from config.scene_file import find_scene, read_scene
from sim_core.integrity import require_integrity

ROOT = Path(__file__).parents[2]
PATTERNS = ROOT / "config" / "patterns"
NIST = (PATTERNS / "eur_columns.nist.xml").read_text(encoding="utf-8")
STACKBUILDER = (PATTERNS / "eur_columns.stackbuilder.xml").read_text(encoding="utf-8")
PALLY = json.loads((PATTERNS / "eur_columns.pally.json").read_text(encoding="utf-8"))
BOMB = (
    '<!DOCTYPE l [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>'
    "<Response>&c;</Response>"
)
EXTERNAL = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><Response>&x;</Response>'


def package(**changes: Any) -> dict[str, Any]:
    return {"id": "a", "size_m": [0.4, 0.3, 0.25], "mass_kg": 10, "position_m": [0, 0, 0.269], **changes}


def scene(*packages: dict[str, Any], **parts: Any) -> str:
    sled = {"profile": "eumos", "level_g": 0.5, **parts.pop("sled", {})}
    return json.dumps({"name": "t", "load": {"packages": packages or [package()]}, "sled": sled, **parts})


SECOND = package(id="b", position_m=[0.35, 0, 0.269])

Case = tuple[str, str | bytes, tuple[str, ...]]
# File name, content, what the one line must say.
BAD_SCENES: dict[str, Case] = {
    "NaN mass": ("s.json", scene(package(mass_kg=float("nan"))), ("NaN", "finite number")),
    "negative mass": ("s.json", scene(package(mass_kg=-1)), ("load.packages.0.mass_kg = -1", "greater than 0")),
    "zero mass": ("s.json", scene(package(mass_kg=0)), ("load.packages.0.mass_kg = 0", "greater than 0")),
    "NaN size": ("s.json", scene(package(size_m=[float("nan"), 1, 1])), ("NaN", "finite number")),
    "negative size": ("s.json", scene(package(size_m=[1, -1, 1])), ("size_m.1 = -1", "greater than 0")),
    "zero size": ("s.json", scene(package(size_m=[1, 1, 0])), ("size_m.2 = 0", "greater than 0")),
    "size in mm": ("s.json", scene(package(size_m=[400, 300, 250])), ("size_m.0 = 400", "10 m", "millimetres")),
    "unknown key": ("s.json", scene(package(weight=3)), ("load.packages.0.weight = 3", "unknown key")),
    "unknown material": (
        "s.json", scene(package(surface="velvet")), ("load.packages.0.surface = velvet", "unknown material")
    ),
    "level above 2 g": ("s.json", scene(sled={"level_g": 2.5}), ("sled.level_g = 2.5", "less than or equal to 2")),
    "level below 0": ("s.json", scene(sled={"level_g": -0.5}), ("sled.level_g = -0.5", "equal to 0")),
    "plateau 0": ("s.json", scene(sled={"plateau_s": 0}), ("sled.plateau_s = 0", "equal to 0.3")),
    "rolls backwards": (
        "s.json",
        scene(sled={"level_g": 0.1, "fall_s": 0.5, "deceleration_g": 2}),
        ("sled.fall_s = 0.5", "shorter"),
    ),
    "auto with a step": (
        "s.json", scene(solver={"engine": "auto", "time_step_s": 0.001}), ("engine auto chooses step and iterations",)
    ),
    "auto with iterations": (
        "s.json", scene(solver={"engine": "auto", "iterations": 40}), ("engine auto chooses step and iterations",)
    ),
    "tolerance 0": (
        "s.json", scene(solver={"tolerance_mm": 0}), ("solver.tolerance_mm = 0", "greater than or equal to 0.05")
    ),
    "tolerance of 2 m": (
        "s.json", scene(solver={"tolerance_mm": 2000}), ("solver.tolerance_mm = 2000", "less than or equal to 1000")
    ),
    "NaN tolerance": ("s.json", scene(solver={"tolerance_mm": float("nan")}), ("NaN", "finite number")),
    "overlap": ("s.json", scene(package(), SECOND), ("overlap of a and b = 50.00 mm", "at most 1 mm")),
    "inside the pallet": (
        "s.json", scene(package(position_m=[0, 0, 0.125])), ("overlap of pallet and a = 144.00 mm",)
    ),
    "off the pallet": (
        "s.json",
        scene(package(size_m=[1.4, 0.3, 0.25], position_m=[0.65, 0, 0.269])),
        ("position of a = centre 50.0 mm off the pallet", "1.2 m x 0.8 m"),
    ),
    "floating": (
        "s.json", scene(package(position_m=[0, 0, 0.3])), ("support of a = 31.0 mm above", "within 2 mm")
    ),
    "truncated XML": ("s.xml", NIST[: len(NIST) // 2], ("XML", "not well-formed")),
    "entity bomb": ("s.xml", BOMB, ("XML = ", "no document type, entities")),
    "external entity": ("s.xml", EXTERNAL, ("XML = ", "external references")),
    "breaks its schema": (
        "s.xml", NIST.replace("<Weight>", "<Mass>", 1).replace("</Weight>", "</Mass>", 1),
        ("Package[1]/Article", "Tag 'Weight' expected"),
    ),
    "no number": ("s.xml", NIST.replace("<Weight>", "<Weight>x", 1), ("Article/Weight = x10000",)),
    "wrong unit": ("s.xml", STACKBUILDER.replace("mm|kg", "furlong|stone"), ("furlong|stone", "mm|kg")),
    "empty StackBuilder list": (
        "s.xml",
        STACKBUILDER[: STACKBUILDER.index("<placement")] + STACKBUILDER[STACKBUILDER.rindex("</placement>") + 12 :],
        ("load",),
    ),
    "empty Pally layers": ("s.json", json.dumps({**PALLY, "layers": []}), ("layers",)),
    "pattern file missing": ("s.json", scene(load={"file": "gone.xml"}), ("gone.xml", "no such file")),
    "truncated JSON": ("s.json", scene()[:-20], ("line 1", "is not JSON")),
    "not text": ("s.json", b"\x00\xff\xfe\x80", ("must be UTF-8",)),
    "half a surrogate pair": ("s.json", scene(description="\ud800"), ("description", "valid string")),
    "an endless nest": ("s.json", "[" * 200_000, ("is not JSON that can be read",)),
}  # fmt: skip


def written(folder: Path, case: Case) -> Path:
    path = folder / case[0]
    path.write_bytes(case[1] if isinstance(case[1], bytes) else case[1].encode())
    return path


def tree(folder: Path) -> dict[str, int]:
    """Every file and folder below, with its size."""
    return {str(path.relative_to(folder)): path.stat().st_size for path in sorted(folder.rglob("*"))}


@pytest.fixture
def refuses(tmp_path: Path) -> Callable[..., str]:
    """Runs ``pallet-twin`` in an otherwise empty folder, sees it refuse, and gives its one line."""

    def line(*arguments: str) -> str:
        before = tree(tmp_path)
        done = subprocess.run(
            [sys.executable, "-m", "ros_nodes.cli", *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 2, done.stderr
        assert done.stdout == ""
        assert "Traceback" not in done.stderr
        (only,) = done.stderr.splitlines()
        assert only.startswith("pallet-twin: ")
        assert tree(tmp_path) == before
        return only

    return line


@pytest.mark.parametrize("name", BAD_SCENES)
def test_a_bad_scene_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    """What ``run``, ``up`` and ``check`` do with it before anything else, without the cost of a process."""
    path = written(tmp_path, BAD_SCENES[name])
    before = tree(tmp_path)
    with pytest.raises(RefusedInput) as caught:
        require_integrity(read_scene(find_scene(str(path))))
    message = str(caught.value)
    assert message.splitlines() == [message]
    assert caught.value.exit_code == 2
    for said in BAD_SCENES[name][2]:
        assert said in message
    # Field, value and limit.
    assert " = " in message
    assert ": " in message
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    "name",
    [
        "negative mass", "unknown key", "level above 2 g", "rolls backwards", "overlap", "inside the pallet",
        "entity bomb", "wrong unit", "pattern file missing", "half a surrogate pair",
    ],
)  # fmt: skip
def test_run_refuses_and_writes_nothing(tmp_path: Path, refuses: Callable[..., str], name: str) -> None:
    path = written(tmp_path, BAD_SCENES[name])
    line = refuses("run", path.name)
    for said in BAD_SCENES[name][2]:
        assert said in line


def test_up_refuses_and_starts_nothing(tmp_path: Path, refuses: Callable[..., str]) -> None:
    path = written(tmp_path, BAD_SCENES["rolls backwards"])
    assert "sled.fall_s = 0.5" in refuses("up", path.name)


@pytest.mark.parametrize("command", ["run", "up"])
def test_a_tolerance_without_an_estimate_is_refused(refuses: Callable[..., str], command: str) -> None:
    line = refuses(command, "block_slip", "--no-estimate", "--set", "solver.tolerance_mm=1")
    assert "solver.tolerance_mm = 1.0: cannot be kept with --no-estimate" in line


def test_engine_auto_with_a_step_is_refused(refuses: Callable[..., str]) -> None:
    override = ("--set", "solver.engine=auto", "--set", "solver.time_step_s=0.0020833333333333333")
    assert "engine auto chooses step and iterations: name an engine" in refuses(
        "run", "block_slip", *override
    )


def test_a_scene_of_a_gigabyte_is_refused_unread(tmp_path: Path, refuses: Callable[..., str]) -> None:
    with (tmp_path / "huge.json").open("wb") as file:
        os.truncate(file.fileno(), 2**30)
    assert "huge.json of 1073741824 bytes: at most 16777216 bytes" in refuses("run", "huge.json")


def test_a_scene_that_is_not_there_is_refused(refuses: Callable[..., str]) -> None:
    assert "scene = eur_colums: no such file, and no shipped scene" in refuses("run", "eur_colums")


def test_an_override_that_is_wrong_is_refused(refuses: Callable[..., str]) -> None:
    line = refuses("run", "block_slip", "--set", "load.packages.0.size_m.0.x=1")
    assert "load.packages.0.size_m.0 holds a value, not a part" in line


def test_a_folder_in_use_is_refused(tmp_path: Path, refuses: Callable[..., str]) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("keep", encoding="utf-8")
    assert "--out = out: is not empty" in refuses("run", "block_slip", "--out", "out")


@pytest.mark.parametrize("command", ["judge", "check"])
@pytest.mark.parametrize("content", [b"", b"not a bag", b"\x89MCAP0\r\n" + bytes(100)])
def test_a_bag_that_is_none_is_refused(
    tmp_path: Path, refuses: Callable[..., str], command: str, content: bytes
) -> None:
    (tmp_path / "bag.mcap").write_bytes(content)
    assert "bag.mcap" in refuses(command, "bag.mcap")


def test_a_folder_that_is_no_bag_is_refused(tmp_path: Path, refuses: Callable[..., str]) -> None:
    (tmp_path / "bag").mkdir()
    assert "bag = " in refuses("judge", "bag")


def test_an_empty_pallet_and_one_package_are_fit(tmp_path: Path) -> None:
    for packages in ([], [package()]):
        path = tmp_path / "fit.json"
        path.write_text(scene(load={"packages": packages}), encoding="utf-8")
        assert require_integrity(read_scene(path)) == []
