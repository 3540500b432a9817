"""The folder of a training: what it was made from, how far it is, and its best model so far.

run.json        bags, split, network, training, versions, and every epoch so far
checkpoint.pt   all that the next epoch depends on
model/          the best network so far, see ``classifier.checkpoint``
curves.png      losses, accuracy and speed over the epochs
"""

import fcntl
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from classifier.checkpoint import read_tensors, write_tensors, write_text
from config.errors import RefusedInput

FORMAT = 2
"""Version of the folder; raise it when its layout or the meaning of a checkpoint changes."""
RUN, CHECKPOINT, MODEL, CURVES = "run.json", "checkpoint.pt", "model", "curves.png"
_SAME = {
    "format": "was written by another version",
    "bags": "holds a training on other bags",
    "split": "holds a training with another split",
    "network": "holds a training of another network",
    "training": "holds a training with other settings",
    "weights": "holds a training from other first weights",
    "processes": "holds a training by another number of processes",
    "versions": "was begun with other versions, which may give other weights",
}
"""What has to be the same for a training to go on, and what is said where it is not."""


class RunFolder:
    """One training on disk; a context manager that keeps other trainings out.

    Args:
        out: made where it is missing.
        told: what the training is made from, as JSON.

    Raises:
        RefusedInput: the folder cannot be made, holds something else or another training, or is in use.

    Attributes:
        told: what the training is made from; ``earlier_code`` names other code that had a hand in it.
        is_finished: whether it was over before.
    """

    def __init__(self, out: Path, told: Mapping[str, Any]) -> None:
        self.path = out
        self.told: dict[str, Any] = {"format": FORMAT, **told}
        self.is_finished = False
        try:
            out.mkdir(parents=True, exist_ok=True)
            if not (out / RUN).is_file() and any(entry.name != ".lock" for entry in out.iterdir()):
                raise RefusedInput(
                    "--out", str(out), "holds something else than a training; name another folder"
                )
            self._lock = (out / ".lock").open("w")
            try:
                self._hold()
            except BaseException:
                self._lock.close()
                raise
        except OSError as error:
            raise RefusedInput("--out", str(out), error.strerror or "cannot be used") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()

    def write_run(self, epochs: Sequence[Mapping[str, Any]], *, is_finished: bool) -> None:
        """Writes what there is by now."""
        entry = {**self.told, "finished": is_finished, "epochs": list(epochs)}
        write_text(self.path / RUN, json.dumps(entry, indent=1, allow_nan=False))

    def _hold(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RefusedInput("--out", str(self.path), "is in use by another training") from None
        if not (self.path / RUN).is_file():
            self.write_run([], is_finished=False)
            return
        found, wanted = read_run(self.path), json.loads(json.dumps(self.told))
        for part, what in _SAME.items():
            if found.get(part) != wanted.get(part):
                raise RefusedInput("--out", str(self.path), f"{what}; name another folder")
        earlier = dict.fromkeys((*found.get("earlier_code", ()), found.get("code")))
        self.told["earlier_code"] = [code for code in earlier if code != wanted.get("code")]
        self.is_finished = bool(found.get("finished"))


def read_run(out: Path) -> dict[str, Any]:
    """What a training's folder tells of it.

    Raises:
        RefusedInput: it is none.
    """
    try:
        found = json.loads((out / RUN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise RefusedInput("training", str(out), "must be the folder of a training") from None
    if not isinstance(found, dict):
        raise RefusedInput("training", str(out / RUN), "must be a JSON object")
    return found


def read_checkpoint(out: Path) -> dict[str, Any] | None:
    """The last checkpoint of a training; None before the first epoch is over.

    Raises:
        RefusedInput: it is damaged.
    """
    return read_tensors(out / CHECKPOINT) if (out / CHECKPOINT).is_file() else None


def write_checkpoint(out: Path, state: Mapping[str, Any]) -> None:
    """Puts a checkpoint in the place of the last one, whole or not at all."""
    write_tensors(out / CHECKPOINT, state)


def digest_of(values: object) -> str:
    """SHA-256 of values as JSON."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        RefusedInput: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RefusedInput("weights", str(path), error.strerror or "cannot be read") from None


def code_digest() -> str:
    """SHA-256 of the classifier's own source files: says exactly which code made a run."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return digest_of([[path.name, path.read_text(encoding="utf-8")] for path in files])
