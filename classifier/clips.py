"""Prepared clips of bags, each made once and kept on disk; what they hold comes from the bag's pictures alone."""

import hashlib
import json
import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from pathlib import Path

import numpy as np
import zstandard

from classifier.configuration import NetworkConfig
from classifier.examples import Example
from classifier.frames import Pixels, PreparedClip, prepared_clip
from config.errors import BrokenRecording, PalletTwinError, RefusedInput
from recordings.bag_pictures import has_pictures, pictures_of_bag
from recordings.bag_reader import BagReader
from recordings.campaigns.one_test import bag_digest
from recordings.campaigns.workers import ONE_THREAD
from recordings.draw_bag import draw_bag
from recordings.judge_bag import scene_of_bag

FORMAT = 5
"""Version of prepared clips on disk; raise it when their layout, or what ``classifier.frames`` makes, changes."""

OnClip = Callable[[int, int, object], None]
"""Told how many clips are there, of how many, and the number of the last one."""


class ClipCache:
    """Prepared clips of a network's kind in a folder; several processes can fill and read it at once.

    Args:
        folder: made when it is first written to. Clips of other networks can stand in it, too.
        config: says what frames are to be; only what they depend on tells caches apart.
    """

    def __init__(self, folder: Path, config: NetworkConfig) -> None:
        self.folder, self.config = folder, config
        depends_on = {
            "format": FORMAT,
            "mode": config.mode,
            "size_px": config.size_px,
            "frames": config.frames,
        }
        digest = hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()
        self._own = folder / f"{config.mode}-{config.size_px}px-{digest[:12]}"

    def clip(self, example: Example) -> PreparedClip:
        """The prepared clip of an example, from disk where it is there, else from its bag.

        Raises:
            BrokenRecording: the bag is not the one that the label was given for, or is damaged.
            RefusedInput: it has no pictures and no camera, or the folder cannot be written.
        """
        return self._clip(example.bag, example.label.bag_sha256)

    def has(self, example: Example) -> bool:
        """Whether an example's clip is on disk."""
        return self._path(example.label.bag_sha256).is_file()

    def prepare(
        self, examples: Sequence[Example], *, workers: int = 1, on_progress: OnClip | None = None
    ) -> None:
        """Makes all clips that are not yet there; what is there stays, however it ends.

        Args:
            examples: whose clips are wanted.
            workers: processes; 1 prepares them here.
            on_progress: told after each clip.

        Raises:
            BrokenRecording: see ``clip``.
            RefusedInput: see ``clip``, or a worker died.
        """
        missing = [example for example in examples if not self.has(example)]
        done = len(examples) - len(missing)
        for example in self._made(missing, min(workers, len(missing))):
            done += 1
            if on_progress is not None:
                on_progress(done, len(examples), example.number)

    def _made(self, examples: Sequence[Example], workers: int) -> Iterator[Example]:
        """Each example when its clip is on disk."""
        if workers <= 1:
            for example in examples:
                self.clip(example)
                yield example
            return
        os.environ.update(ONE_THREAD)
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin_worker)
        try:
            # What a worker is told has nothing of the label but the digest of the bag.
            tasks = {
                pool.submit(_prepare, self, example.bag, example.label.bag_sha256): example
                for example in examples
            }
            for task in as_completed(tasks):
                refused = task.result()
                if refused is not None:
                    kind, arguments = refused
                    raise kind(*arguments)
                yield tasks[task]
        except BrokenProcessPool:
            limit = "one was killed, for lack of memory for instance; the same command goes on"
            raise RefusedInput("workers", workers, limit) from None
        finally:
            pool.shutdown(cancel_futures=True)

    def _path(self, bag_sha256: str) -> Path:
        return self._own / f"{bag_sha256}.clip"

    def _clip(self, bag: Path, bag_sha256: str) -> PreparedClip:
        path = self._path(bag_sha256)
        try:
            return clip_from_bytes(path.read_bytes())
        except (OSError, ValueError, zstandard.ZstdError):
            pass
        require_digest(bag, bag_sha256)
        clip = clip_of_bag(bag, self.config)
        try:
            self._own.mkdir(parents=True, exist_ok=True)
            scratch = path.with_suffix(f".{os.getpid()}.part")
            scratch.write_bytes(clip_to_bytes(clip))
            scratch.replace(path)
        except OSError as error:
            what = error.strerror or "cannot be written"
            raise RefusedInput("--cache", str(self.folder), f"{what}; name another folder") from None
        return clip


def clip_of_bag(bag: Path, config: NetworkConfig) -> PreparedClip:
    """The prepared clip of a bag; nothing but its pictures goes in, or where it has none, those of its recipe.

    Args:
        bag: directory or ``.mcap`` file.
        config: says what frames are to be.

    Raises:
        BrokenRecording: the bag is damaged.
        RefusedInput: it has no pictures and no camera, or less than two pictures.
    """
    return prepared_clip((pixels for _, pixels in stamped_pictures_in(bag)), config)


def stamped_pictures_in(bag: Path) -> Iterator[tuple[int, Pixels]]:
    """Every picture of a bag in order: its stamp [ns], and red, green and blue, shape [height, width, 3].

    A bag without pictures whose scene has a camera is a recipe: they are drawn as that camera would have recorded them.

    Raises:
        BrokenRecording: the bag is damaged, or lacks what drawing needs.
        RefusedInput: it has no pictures and no camera.
    """
    with BagReader(bag) as reader:
        # A topic can stand in a bag and have no message.
        pictures = pictures_of_bag(reader) if has_pictures(reader) else iter(())
        first = next(pictures, None)
        if first is not None:
            yield first.stamp_ns, first.pixels
            for picture in pictures:
                yield picture.stamp_ns, picture.pixels
            return
        if scene_of_bag(reader).camera is None:
            raise RefusedInput("bag", str(bag), "has no pictures, and its scene has no camera to draw them")
    with tempfile.TemporaryDirectory(prefix="pallet-twin-") as scratch:
        drawn = draw_bag(bag, Path(scratch) / "bag").bag
        with BagReader(drawn) as reader:
            for picture in pictures_of_bag(reader):
                yield picture.stamp_ns, picture.pixels


def clip_to_bytes(clip: PreparedClip) -> bytes:
    """A clip as one block: a line of JSON, then all else, packed without loss.

    Frames are stored as their differences to the frame before, which are mostly zero.
    """
    head = {
        "format": FORMAT, "shape": clip.frames.shape, "critical": clip.critical, "followed": clip.followed,
        "remark": clip.remark, "pictures": len(clip.change),
    }  # fmt: skip
    steps = clip.frames.copy()
    steps[1:] -= clip.frames[:-1]
    body = clip.numbers.astype("<i8").tobytes() + clip.change.astype("<f8").tobytes() + steps.tobytes()
    return json.dumps(head).encode() + b"\n" + zstandard.ZstdCompressor(level=3).compress(body)


def clip_from_bytes(content: bytes) -> PreparedClip:
    """Reads a clip that ``clip_to_bytes`` wrote; same clip in, same clip out.

    Raises:
        ValueError: it is none, or one of another format.
        zstandard.ZstdError: it is damaged.
    """
    line, _, packed = content.partition(b"\n")
    head = json.loads(line)
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise ValueError("no clip of this format")
    body = zstandard.ZstdDecompressor().decompress(packed)
    time, pictures = head["shape"][0], head["pictures"]
    numbers = np.frombuffer(body, "<i8", time).astype(np.intp)
    change = np.frombuffer(body, "<f8", pictures, offset=8 * time).astype(np.float64)
    frames = np.frombuffer(body, np.uint8, offset=8 * (time + pictures)).reshape(head["shape"]).copy()
    for number in range(1, time):
        frames[number] += frames[number - 1]
    return PreparedClip(frames, numbers, head["critical"], change, head["followed"], head["remark"])


def require_digest(bag: Path, bag_sha256: str) -> None:
    """Refuses a bag that is not the one that a label was given for.

    Raises:
        BrokenRecording: it is not, or cannot be read.
    """
    found = _digest_of(bag)
    if found != bag_sha256:
        raise BrokenRecording("bag", str(bag), f"has the digest {found[:12]}…, its label {bag_sha256[:12]}…")


def _digest_of(bag: Path) -> str:
    try:
        return bag_digest({path.name: path.read_bytes() for path in bag.iterdir()})
    except OSError as error:
        raise BrokenRecording("bag", str(bag), error.strerror or "cannot be read") from None


def _prepare(
    cache: ClipCache, bag: Path, bag_sha256: str
) -> tuple[type[RefusedInput], tuple[str, str, str]] | None:
    """In a worker: makes a clip; what refuses it comes back as a value, since errors of three parts do not travel."""
    try:
        cache._clip(bag, bag_sha256)
    except RefusedInput as refused:
        return type(refused), (refused.field, str(refused.value), refused.limit)
    except PalletTwinError as error:
        return RefusedInput, ("bag", str(bag), str(error))
    return None


def _begin_worker() -> None:
    """One core's worth of threads, no interrupts but the driver's, and an end when that ends."""
    from recordings.campaigns.one_test import prepare_worker

    prepare_worker()
    threading.Thread(target=_end_with_the_driver, daemon=True).start()


def _end_with_the_driver() -> None:
    driver = parent_process()
    if driver is not None:
        driver.join()
        os._exit(1)
