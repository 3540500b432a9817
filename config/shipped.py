"""What comes with the product, and how one piece of it is named on the command line."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from config.errors import RefusedInput


@dataclass(frozen=True)
class Shipped:
    """One kind of shipped files.

    Attributes:
        what: what a refusal calls one of them.
        folder: where they stand, below ``config``.
        endings: of their names.
        ending_is_named: whether a name has its ending.
    """

    what: str
    folder: str
    endings: tuple[str, ...] = (".json",)
    ending_is_named: bool = False

    def names(self) -> list[str]:
        """All of them by name."""
        return sorted(self._files())

    def find(self, name_or_path: str) -> Path:
        """The path of one: a path as given, or the name of a shipped one.

        Raises:
            RefusedInput: neither exists.
        """
        path = Path(name_or_path)
        try:
            if path.is_file():
                return path
        except (OSError, ValueError) as error:
            raise RefusedInput(self.what, name_or_path, f"cannot be read: {error}") from None
        shipped = self._files()
        if name_or_path in shipped:
            return shipped[name_or_path]
        limit = f"no such file, and no shipped {self.what}; shipped: {', '.join(sorted(shipped))}"
        raise RefusedInput(self.what, name_or_path, limit)

    def _files(self) -> dict[str, Path]:
        found = {}
        for entry in files("config").joinpath(self.folder).iterdir():
            ending = next((ending for ending in self.endings if entry.name.endswith(ending)), None)
            if ending is not None:
                name = entry.name if self.ending_is_named else entry.name.removesuffix(ending)
                found[name] = Path(str(entry))
        return found


SCENES = Shipped("scene", "scenes")
CAMPAIGNS = Shipped("campaign", "campaigns")
PATTERNS = Shipped(
    "pattern", "patterns", (".nist.xml", ".pally.json", ".stackbuilder.xml"), ending_is_named=True
)
"""What stands before the first dot is the load: files that share it hold one load in several formats."""
