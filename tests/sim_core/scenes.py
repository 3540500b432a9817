"""Small scenes for the physics tests."""

from typing import Any

from config.scene import Scene
from config.scene_file import find_scene, read_scene, validate_scene
from sim_core.judge import EumosJudge, PackageResult
from sim_core.run import TestResult, run_test

GRAVITY = 9.81


def block_scene(*, level_g: float, friction: float, size_m: tuple[float, float, float], **sled: Any) -> Scene:
    """One block on the sled itself, on a trapezoid of 0.05 s + 0.5 s + 0.05 s unless told otherwise."""
    a = level_g * GRAVITY
    profile = {"profile": "table", "times_s": [0.0, 0.05, 0.55, 0.6], "acceleration_mps2": [0.0, a, a, 0.0]}
    return validate_scene(
        {
            "name": "block",
            "load": {
                "packages": [
                    {"id": "block", "size_m": size_m, "mass_kg": 10, "position_m": [0, 0, size_m[2] / 2]}
                ]
            },
            "pallet": None,
            "surfaces": {"pairs": [{"between": ["cardboard", "sled"], "friction": friction}]},
            "sled": {**profile, **sled},
        }
    )


def run_shipped(name: str, *overrides: str) -> TestResult:
    """Runs a shipped scene."""
    return run_test(read_scene(find_scene(name), overrides))


def packages_of(judge: EumosJudge) -> dict[str, PackageResult]:
    """Results by package id."""
    return {package.id: package for package in judge.packages()}
