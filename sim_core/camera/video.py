"""Pictures as an MP4 that any player shows."""

from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path

import av

from config.errors import RefusedInput
from sim_core.camera.source import Picture

QUALITY = "20"
"""Constant rate factor of x264: lower is better; 18 is said to look like the original."""


def write_video(
    pictures: Iterable[Picture],
    path: Path,
    *,
    rate_hz: float,
    on_picture: Callable[[int], None] | None = None,
) -> int:
    """Writes pictures as H.264 in an MP4, whole or not at all, and says how many.

    The same pictures give the same bytes with the same libraries.

    Args:
        pictures: all of one size with even edges.
        path: file to write; one that exists is replaced.
        rate_hz: pictures a second of the video.
        on_picture: called with the number of pictures written so far.

    Raises:
        RefusedInput: the path cannot be written, or is no ``.mp4``.
    """
    if path.suffix.lower() != ".mp4":
        raise RefusedInput("--video", str(path), "must end in .mp4")
    scratch = path.with_name(path.name + ".part")
    count = 0
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(scratch), "w", format="mp4", options={"movflags": "+faststart"}) as file:
            stream = file.add_stream("libx264", rate=Fraction(rate_hz).limit_denominator(1000))
            stream.options = {"crf": QUALITY, "preset": "veryfast", "threads": "2"}
            stream.pix_fmt = "yuv420p"
            for picture in pictures:
                if count == 0:
                    stream.height, stream.width = picture.pixels.shape[:2]
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture.pixels, format="rgb24")))
                count += 1
                if on_picture is not None:
                    on_picture(count)
            if count:
                file.mux(stream.encode(None))
        if count:
            scratch.replace(path)
    except OSError as error:
        raise RefusedInput("--video", str(path), error.strerror or "cannot be written") from None
    finally:
        scratch.unlink(missing_ok=True)
    return count
