"""The defects of the stability table that are known and not caught yet; every other ``wrong`` is news."""

from sim_core.stress.model import KnownWrong

BOTH = ("bullet", "mujoco")

_REASONS: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    (
        "film flows and tears once a pose frame, so sampling.poses_hz changes the physics; the companion keeps it and"
        " agrees; after a roll-back the energy ledger takes all frames since the snapshot as one, and is content",
        ("film_tears_30hz",),
        BOTH,
    ),
    (
        "a slack film that has flowed runs past edges until its elements have no area left: a strain of 1.4 where the"
        " hoop has 0.47, and a pull that throws the box another 0.25 m",
        ("film_flows_on_30hz",),
        ("bullet",),
    ),
    (
        "the error estimate knows the time step, not the film's mesh, whose spacing no tolerance chooses",
        ("film_overhang",),
        BOTH,
    ),
    (
        "levels of boxes are one where they are nearer than 0.2 of the spacing, 20 mm: here the last bit of a settled"
        " height decides, and moves the peak from 4.3 to 5.2 mm",
        ("film_plates",),
        ("mujoco",),
    ),
    (
        "plates pressed together creep on while they slide, in the companion too",
        ("film_loose_plates",),
        ("bullet",),
    ),
)

KNOWN_WRONG: tuple[KnownWrong, ...] = tuple(
    KnownWrong(row, engine, reason)
    for reason, rows, engines in _REASONS
    for row in rows
    for engine in engines
)
"""One entry for each row and engine, with the reason."""
