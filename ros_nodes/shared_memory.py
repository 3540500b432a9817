"""Shared memory that killed nodes leave behind: each keeps 64 MB of it until somebody takes it away."""

import os
import time
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
LEAST_AGE_S = 1.0
"""What is younger may be in the making."""
PREFIXES = ("fastrtps_", "sem.fastrtps_")


def remove_orphans(folder: Path = SHARED_MEMORY, *, but_mine: bool = False) -> list[str]:
    """Removes this user's segments of the middleware that no process has mapped or open, and names them.

    A killed process cannot do it, and the middleware's next start doesn't.

    Args:
        folder: where the segments are.
        but_mine: what this process itself still holds doesn't count: its middleware is shut down.
    """
    mine = [
        entry
        for entry in (folder.iterdir() if folder.is_dir() else ())
        if entry.name.startswith(PREFIXES) and _is_old_and_mine(entry)
    ]
    if not mine:
        return []
    used = _in_use(folder, without=os.getpid() if but_mine else None)
    removed = []
    for entry in mine:
        # A segment and its locks go by one name: while one of them is in use, all stay.
        stem = entry.name.removeprefix("sem.").removesuffix("_mutex").removesuffix("_el").removesuffix("_sl")
        if not any(stem in name for name in used):
            entry.unlink(missing_ok=True)
            removed.append(entry.name)
    return sorted(removed)


def _is_old_and_mine(entry: Path) -> bool:
    try:
        status = entry.stat()
    except FileNotFoundError:
        return False
    return status.st_uid == os.getuid() and time.time() - status.st_mtime > LEAST_AGE_S


def _in_use(folder: Path, without: int | None) -> set[str]:
    """Names of the folder's files that any process of this user, but for one, has mapped or open."""
    used: set[str] = set()
    for process in Path("/proc").iterdir():
        if not process.name.isdigit() or process.name == str(without):
            continue
        try:
            links = list((process / "fd").iterdir())
            targets = [_target(link) for link in links]
            # After the open files: a segment that is being made is open first, and then mapped.
            maps = (process / "maps").read_text().splitlines()
        except OSError:
            # It ended, or is another user's: then so are its segments.
            continue
        paths = targets + [line.split(maxsplit=5)[-1] for line in maps]
        used |= {Path(path).name for path in paths if path.startswith(f"{folder}/")}
    return used


def _target(link: Path) -> str:
    """What an open file is; nothing for one that is closed by now."""
    with suppress(OSError):
        return str(link.readlink())
    return ""
