"""A bench's recording beside the twin: whose scene it is, and what differs, in words."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from config.scene import Scene


def scene_for(bag: Path, named: str | None) -> Scene:
    """The scene that a user names, else the one that stands in the bag.

    Raises:
        RefusedInput: the named scene cannot be used.
        BrokenRecording: none is named, and the bag holds none.
    """
    from recordings.bag_reader import BagReader
    from recordings.judge_bag import scene_of_bag
    from recordings.recorded_sled import load_scene

    if named is not None:
        return load_scene(named)
    with BagReader(bag) as reader:
        return scene_of_bag(reader)


def difference_lines(told: dict[str, Any]) -> Iterator[str]:
    """What measured and simulated displacement have between them, a line each."""
    yield from told["sled"]
    if not told["packages"]:
        yield "nothing to compare: no measured time falls into the simulated test"
        return
    yield (
        f"measured less simulated: {told['rms_mm']:.2f} mm rms over {told['points']} points of {told['displacement']},"
        f" at most {told['largest_mm']:.1f} mm, {told['package']} at {told['largest_at_s']:.2f} s;"
        f" {100.0 * told['beyond_share']:.0f} % of them beyond the measurement's own uncertainty"
    )
