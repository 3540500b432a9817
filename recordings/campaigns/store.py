"""The folder of a campaign: whole tests only, whatever ended the run before.

campaign.json      the campaign, and the versions that it runs with
tests/00017/       bag/, label.json and cost.json of draw 17; appears whole, by renaming
labels.parquet     all label rows, by number
costs.parquet      what each test took
refused.json       draws that made no test, with their reasons
"""

import fcntl
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from config.campaign import Campaign
from config.errors import BrokenRecording, RefusedInput
from recordings.campaigns.drafts import Factors, RefusedDraft
from recordings.campaigns.labels import Label, label_from_json, label_table, table_of, write_parquet
from recordings.campaigns.one_test import Cost, Done
from recordings.campaigns.workers import GIVEN_UP
from sim_core.report import PICTURED, versions

FORMAT = 1
"""Version of the folder; raise it when its layout changes."""


class CampaignFolder:
    """One campaign on disk; a context manager that keeps other runs of it out.

    Args:
        out: made where it is missing.
        campaign: the campaign.

    Raises:
        RefusedInput: the folder cannot be made, holds something else, another campaign or one begun with other
            versions, or is in use.

    Attributes:
        labels: finished tests by number.
        costs: what they took.
        refused: refused draws by number.
    """

    def __init__(self, out: Path, campaign: Campaign) -> None:
        self.path = out
        self._tests = out / "tests"
        try:
            self._claim(campaign)
        except OSError as error:
            raise RefusedInput("--out", str(out), error.strerror or "cannot be used") from None
        self.labels: dict[int, Label] = {}
        self.costs: dict[int, Cost] = {}
        self.refused: dict[int, RefusedDraft] = self._given_up()
        for folder in sorted(self._tests.iterdir()):
            if folder.name.startswith("."):
                shutil.rmtree(folder, ignore_errors=True)
            else:
                self._take(folder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()

    @property
    def bag_bytes(self) -> int:
        """What all bags take."""
        return sum(label.bag_bytes for label in self.labels.values())

    def keep(self, done: Done) -> None:
        """Puts a finished test where it belongs, whole or not at all.

        Raises:
            OSError: there is no room, or the folder went away.
        """
        assert done.label is not None and done.cost is not None
        part = self._tests / f".{done.number:05d}.part"
        try:
            shutil.rmtree(part, ignore_errors=True)
            (part / "bag").mkdir(parents=True)
            for name, content in done.bag.items():
                (part / "bag" / name).write_bytes(content)
            (part / "label.json").write_text(done.label.to_json() + "\n", encoding="utf-8")
            (part / "cost.json").write_text(json.dumps(asdict(done.cost)) + "\n", encoding="utf-8")
            part.rename(test_folder(self.path, done.number))
        except OSError:
            shutil.rmtree(part, ignore_errors=True)
            raise
        self.labels[done.number], self.costs[done.number] = done.label, done.cost

    def refuse(self, number: int, factors: Factors, reason: str) -> None:
        """Remembers a draw that makes no test."""
        self.refused[number] = RefusedDraft(number, factors, reason)

    def write_tables(self) -> None:
        """Writes the tables of what there is."""
        if self.labels:
            write_parquet(label_table(list(self.labels.values())), self.path / "labels.parquet")
            costs = [{"number": number, **asdict(cost)} for number, cost in sorted(self.costs.items())]
            write_parquet(table_of(costs), self.path / "costs.parquet")
        refused = [asdict(self.refused[number]) for number in sorted(self.refused)]
        _write(self.path / "refused.json", json.dumps(refused, indent=1, ensure_ascii=False))

    def _given_up(self) -> dict[int, RefusedDraft]:
        """Tests that no worker brought to an end: another draw has taken their place, so they stay as they are."""
        try:
            found = json.loads((self.path / "refused.json").read_text(encoding="utf-8"))
            drafts = [RefusedDraft(**entry) for entry in found]
        except (OSError, ValueError, TypeError):
            return {}
        return {draft.number: draft for draft in drafts if draft.reason.startswith(GIVEN_UP)}

    def _claim(self, campaign: Campaign) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        own = self.path / "campaign.json"
        # What a run leaves that ends while it makes the folder.
        begun = (".lock", f"{own.name}.part")
        if not own.is_file() and any(entry.name not in begun for entry in self.path.iterdir()):
            raise RefusedInput(
                "--out", str(self.path), "holds something else than a campaign; name another folder"
            )
        self._lock = (self.path / ".lock").open("w")
        try:
            self._hold(own, campaign)
        except (OSError, RefusedInput):
            self._lock.close()
            raise

    def _hold(self, own: Path, campaign: Campaign) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RefusedInput("--out", str(self.path), "is in use by another run of the campaign") from None
        told = {"format": FORMAT, "campaign": json.loads(campaign.to_json()), "versions": versions(PICTURED)}
        if own.is_file():
            self._require_same(own, told)
        else:
            _write(own, json.dumps(told, indent=1, ensure_ascii=False))
        self._tests.mkdir(exist_ok=True)

    def _require_same(self, own: Path, told: Mapping[str, object]) -> None:
        try:
            found = json.loads(own.read_text(encoding="utf-8"))
        except ValueError:
            found = {}
        found, told = _what_tests_depend_on(found), _what_tests_depend_on(told)
        for part, limit in (
            ("format", "was written by another version; name another folder"),
            (
                "campaign",
                "holds another campaign; name another folder, or give the campaign that it was begun with",
            ),
            ("versions", "was begun with other versions, which may give other bytes; name another folder"),
        ):
            if found.get(part) != told.get(part):
                raise RefusedInput("--out", str(self.path), limit)

    def _take(self, folder: Path) -> None:
        """Counts a test that is whole; clears away one that is not, after a power failure for instance."""
        try:
            label = label_from_json((folder / "label.json").read_text(encoding="utf-8"), str(folder))
            cost = Cost(**json.loads((folder / "cost.json").read_text(encoding="utf-8")))
            size = sum(path.stat().st_size for path in (folder / "bag").iterdir())
            if folder.name != f"{label.number:05d}" or size != label.bag_bytes:
                raise BrokenRecording(
                    "bag", str(folder), f"has {size} bytes, its label says {label.bag_bytes}"
                )
        except (OSError, ValueError, TypeError, BrokenRecording):
            shutil.rmtree(folder, ignore_errors=True)
            return
        self.labels[label.number], self.costs[label.number] = label, cost


def test_folder(out: Path, number: int) -> Path:
    """Where the test of a draw stands in a campaign's folder."""
    return out / "tests" / f"{number:05d}"


test_folder.__test__ = False  # type: ignore[attr-defined]


def read_labels(out: Path) -> list[Label]:
    """All finished tests of a campaign's folder, by number.

    Raises:
        RefusedInput: there is no campaign, or no finished test.
        BrokenRecording: a row is damaged.
    """
    if not (out / "campaign.json").is_file():
        raise RefusedInput(
            "campaign", str(out), "must be the folder of a campaign; pallet-twin campaign makes one"
        )
    found = sorted((out / "tests").glob("[0-9]*/label.json"))
    if not found:
        raise RefusedInput(
            "campaign", str(out), "has no finished test yet; pallet-twin campaign goes on with it"
        )
    return [label_from_json(path.read_text(encoding="utf-8"), str(path)) for path in found]


def _what_tests_depend_on(told: Any) -> dict[str, Any]:
    """Without the room on the disk, which can be raised while a campaign goes on."""
    if not isinstance(told, dict) or not isinstance(told.get("campaign"), dict):
        return {}
    campaign = {key: value for key, value in told["campaign"].items() if key != "disk_gb"}
    return {**told, "campaign": campaign}


def _write(path: Path, text: str) -> None:
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(text + "\n", encoding="utf-8")
    scratch.replace(path)
