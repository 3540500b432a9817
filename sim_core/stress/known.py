"""The defects of the stability table that are known and not caught yet; every other ``wrong`` is news."""

from sim_core.stress.model import KnownWrong

KNOWN_WRONG: tuple[KnownWrong, ...] = ()
"""One entry for each row and engine, with the reason."""
