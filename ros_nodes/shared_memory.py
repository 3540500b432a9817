"""Shared memory that killed nodes leave behind: each keeps 64 MB of it until somebody takes it away."""

import os
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
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
        if entry.name.startswith(PREFIXES) and entry.stat().st_uid == os.getuid()
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


def _in_use(folder: Path, without: int | None) -> set[str]:
    """Names of the folder's files that any process of this user, but for one, has mapped or open."""
    used: set[str] = set()
    for process in Path("/proc").iterdir():
        if not process.name.isdigit() or process.name == str(without):
            continue
        try:
            maps = (process / "maps").read_text().splitlines()
            links = list((process / "fd").iterdir())
        except OSError:
            # It ended, or is another user's: then so are its segments.
            continue
        paths = [line.split(maxsplit=5)[-1] for line in maps]
        for link in links:
            # Also the one that listed them is gone by now.
            with suppress(OSError):
                paths.append(str(link.readlink()))
        used |= {Path(path).name for path in paths if path.startswith(f"{folder}/")}
    return used
