"""The colours of every picture: one for what the camera saw, one for what the model says.

Blue against orange stays apart for every common colour blindness, and both keep a contrast of about 3 : 1 on white
paper and more on the viewer's dark ground.
"""

from __future__ import annotations

Colour = tuple[int, int, int]

MEASURED: Colour = (43, 140, 220)
SIMULATED: Colour = (224, 118, 0)
IMPACT: Colour = (128, 128, 128)
TABLE: Colour = (58, 60, 64)
GRID: Colour = (104, 108, 114)

COLOURS = {"measured": MEASURED, "simulated": SIMULATED}
"""Colour of each motion by its name."""

AXIS_COLOURS: tuple[Colour, Colour, Colour] = ((214, 84, 120), (62, 160, 92), (126, 110, 214))
"""x, y and z where a vector is drawn by component."""


def hex_colour(colour: Colour) -> str:
    """`#rrggbb`, as matplotlib and CSS write it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """`colour` with a `share` (0 to 1) of `other` in it."""
    red, green, blue = (round((1.0 - share) * a + share * b) for a, b in zip(colour, other, strict=True))
    return red, green, blue
