"""Steady colours of pallet and packages, and those of strain, the same in every view."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from config.package import Package
from config.wrap import FilmLaw

Colour = tuple[float, float, float]

PALLET_COLOUR: Colour = (0.72, 0.53, 0.32)
INTERLAYER_COLOUR: Colour = (0.55, 0.55, 0.50)
# Neighbouring layers differ in lightness as well as in hue, so that they part without colour vision too.
_LAYER_COLOURS: tuple[Colour, ...] = (
    (0.30, 0.45, 0.70),
    (0.90, 0.65, 0.35),
    (0.35, 0.62, 0.45),
    (0.85, 0.55, 0.62),
    (0.45, 0.38, 0.65),
    (0.80, 0.78, 0.45),
)

# Blue, green, yellow, red: none of the film's strain, one third, two thirds, all that it bears.
_STRAIN_SCALE = np.array([(0.15, 0.25, 0.85), (0.10, 0.70, 0.30), (0.95, 0.85, 0.10), (0.85, 0.10, 0.10)])


def package_colour(package: Package) -> Colour:
    """Red, green and blue from 0 to 1, by layer; packages of no layer share the first colour."""
    if package.kind == "interlayer":
        return INTERLAYER_COLOUR
    return _LAYER_COLOURS[((package.layer or 1) - 1) % len(_LAYER_COLOURS)]


def full_strain(law: FilmLaw) -> float:
    """The strain that is red: where the film begins to be drawn, or where it breaks if it is never drawn."""
    return min(law.yield_force_npm / law.stiffness_npm, law.break_strain)


def strain_colours(strains: NDArray[Any], full: float) -> NDArray[np.float64]:
    """Red, green and blue from 0 to 1 by strain, shape [n, 3].

    Straight between blue at no strain, green at a third of ``full``, yellow at two thirds, and red from ``full`` on.

    Args:
        strains: strains, shape [n].
        full: the strain that is red, see ``full_strain``.
    """
    thirds = np.linspace(0.0, full, len(_STRAIN_SCALE))
    return np.stack([np.interp(strains, thirds, channel) for channel in _STRAIN_SCALE.T], axis=-1)
