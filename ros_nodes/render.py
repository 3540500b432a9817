"""A recording drawn anew: a folder with bag and video."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ros_nodes.one_test import claim_folder


@dataclass(frozen=True)
class Rendered:
    """What was drawn.

    Attributes:
        pictures: how many.
        drawn_by: what drew them.
        bag: the new bag.
        video: the same as MP4.
    """

    pictures: int
    drawn_by: str
    bag: Path
    video: Path


def render_bag(
    path: Path,
    out: Path | None,
    overrides: Sequence[str],
    *,
    on_picture: Callable[[int, int, object], None] | None = None,
) -> Rendered:
    """Draws a recording's pictures anew into ``out``, or the first free one of ``runs/NAME-render`` and so on.

    Args:
        path: the recording.
        out: a new or an empty folder, or None.
        overrides: ``camera.key=value`` texts.
        on_picture: called with pictures drawn, how many there will be, and the last one's number.

    Raises:
        RefusedInput: recording, camera or folder cannot be used.
    """
    from msgs_adapters.topics import PACKAGES_POSES
    from recordings.bag_reader import BagReader
    from recordings.draw_bag import draw_bag, scene_with_camera
    from recordings.judge_bag import scene_of_bag, topic_in_bag
    from sim_core.camera.moments import PictureMoments
    from sim_core.camera.video import write_video

    with BagReader(path) as reader:
        scene = scene_with_camera(scene_of_bag(reader), overrides)
        frames = reader.topics[topic_in_bag(reader, PACKAGES_POSES.name)].message_count
    moments = PictureMoments(scene)
    total = moments.count(frames)
    folder = claim_folder(out, f"{scene.name}-render")

    def tell(count: int, _time_s: float) -> None:
        if on_picture is not None:
            on_picture(count, total, count)

    drawn = draw_bag(path, folder / "bag", overrides, on_picture=tell)
    video = folder / "video.mp4"
    write_video(drawn.pictures, video, rate_hz=moments.rate_hz)
    return Rendered(len(drawn.pictures), drawn.drawn_by, drawn.bag, video)
