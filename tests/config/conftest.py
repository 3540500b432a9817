"""What the tests of the palletising readers share."""

from collections.abc import Callable
from pathlib import Path

import pytest

from config.errors import RefusedInput
from config.readers import PatternPallet, read_pattern
from config.readers.pallet import bounds


@pytest.fixture
def read_only(tmp_path: Path) -> Callable[[str], PatternPallet]:
    """Writes a text into a file and reads the one pallet of it."""

    def read(text: str) -> PatternPallet:
        path = tmp_path / "pattern.txt"
        path.write_text(text, encoding="utf-8")
        (pallet,) = read_pattern(path).pallets
        return pallet

    return read


@pytest.fixture
def refuse(tmp_path: Path) -> Callable[[str | bytes], RefusedInput]:
    """Writes content into a file and gives the one-line refusal that reading it raises."""

    def refusal(content: str | bytes) -> RefusedInput:
        path = tmp_path / "bad"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        with pytest.raises(RefusedInput) as caught:
            read_pattern(path)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 500
        return caught.value

    return refusal


@pytest.fixture
def extents_mm() -> Callable[..., tuple[float, ...]]:
    """The x, y, z limits of a package in millimetres, x and y from the pallet's corner, z from its deck."""

    def extents(pallet: PatternPallet, index: int = 0) -> tuple[float, ...]:
        box = bounds(pallet.packages[index])
        x, y = pallet.size_m[0] / 2, pallet.size_m[1] / 2
        metres = (box.x_min + x, box.x_max + x, box.y_min + y, box.y_max + y, box.z_min, box.z_max)
        return tuple(round(value * 1000, 6) for value in metres)

    return extents
