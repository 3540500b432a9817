"""Steady colours of pallet and packages, the same in every view."""

from config.package import Package

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


def package_colour(package: Package) -> Colour:
    """Red, green and blue from 0 to 1, by layer; packages of no layer share the first colour."""
    if package.kind == "interlayer":
        return INTERLAYER_COLOUR
    return _LAYER_COLOURS[((package.layer or 1) - 1) % len(_LAYER_COLOURS)]
