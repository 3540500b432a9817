"""How many readers each topic of a graph must have before the first message, as text in a parameter."""

from collections.abc import Mapping

from config.errors import RefusedInput


def readers_text(wanted: Mapping[str, int]) -> str:
    """``topic=count`` pairs, comma-separated."""
    return ",".join(f"{name}={count}" for name, count in wanted.items())


def readers_wanted(text: str) -> dict[str, int]:
    """The counts that ``readers_text`` wrote.

    Raises:
        RefusedInput: the text has another form.
    """
    wanted: dict[str, int] = {}
    for pair in filter(None, text.split(",")):
        name, equals, count = pair.partition("=")
        if not equals or not count.isdecimal():
            raise RefusedInput("readers", pair, "must be topic=count")
        wanted[name] = int(count)
    return wanted
