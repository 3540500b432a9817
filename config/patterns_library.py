"""The palletising files that come with the product, and how one is named."""

from importlib.resources import files
from pathlib import Path

from config.errors import RefusedInput

PATTERN_ENDINGS = (".nist.xml", ".pally.json", ".stackbuilder.xml")


def shipped_patterns() -> list[str]:
    """Names of the palletising files that come with the product, such as ``eur_columns.nist.xml``.

    What stands before the first dot is the load: files that share it hold one load in several formats.
    """
    folder = files("config").joinpath("patterns")
    return sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(PATTERN_ENDINGS))


def find_pattern(name_or_path: str) -> Path:
    """The path of a palletising file: a path as given, or the name of a shipped one.

    Raises:
        RefusedInput: neither exists.
    """
    path = Path(name_or_path)
    try:
        if path.is_file():
            return path
    except (OSError, ValueError) as error:
        raise RefusedInput("pattern", name_or_path, f"cannot be read: {error}") from None
    if name_or_path in shipped_patterns():
        return Path(str(files("config").joinpath("patterns", name_or_path)))
    shipped = ", ".join(shipped_patterns())
    raise RefusedInput("pattern", name_or_path, f"no such file, and no shipped pattern; shipped: {shipped}")
