"""The colours of all pictures: blue for the measurement, orange for the model.

Blue and orange remain distinguishable under every common colour blindness. Both have a contrast of about 3 : 1 on white
paper, and more on the viewer's dark background.
"""

from __future__ import annotations

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

MEASURED: Colour = (43, 140, 220)
SIMULATED: Colour = (224, 118, 0)
IMPACT: Colour = (128, 128, 128)
ALARM: Colour = (190, 60, 60)
TABLE: Colour = (58, 60, 64)
GRID: Colour = (104, 108, 114)
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (0, 0, 0)

COLOURS = {"measured": MEASURED, "simulated": SIMULATED}
"""Colour of each motion by its name."""

AXIS_COLOURS: tuple[Colour, Colour, Colour] = ((214, 84, 120), (62, 160, 92), (126, 110, 214))
"""x, y and z, for vectors drawn by component."""

THROW_COLOURS: tuple[Colour, ...] = (
    (86, 180, 233),
    (240, 228, 66),
    (204, 121, 167),
    (0, 178, 130),
    (225, 120, 60),
    (150, 130, 255),
    (190, 190, 190),
)
"""Colours of several throws, or of several models of one throw, in their order; after the last, the first again. Those of
Okabe and Ito that stand out from the viewer's dark background, and others."""

FACE_COLOURS: tuple[Colour, ...] = (
    (0, 114, 178),
    (240, 228, 66),
    (213, 94, 0),
    (86, 180, 233),
    (0, 158, 115),
    (204, 121, 167),
    (105, 30, 0),
    (0, 60, 75),
    (195, 225, 180),
    (150, 75, 60),
    (60, 30, 165),
    (60, 240, 255),
    (180, 180, 105),
    (120, 90, 120),
    (225, 180, 195),
    (135, 120, 255),
    (105, 60, 60),
    (195, 30, 0),
    (240, 135, 0),
    (150, 120, 75),
)
"""One for each face of a die. The first six are Okabe and Ito's; each further one lies as far as possible from those
before it. Any two of the first 4, 12 and 20 differ by a CIEDE2000 of at least 20, 12 and 9, also for readers who lack one
kind of cone (Machado, Oliveira and Fernandes, IEEE Trans. Vis. Comput. Graph. 15, 1291, 2009)."""

SPINNING_COLOUR: Colour = (0, 0, 0)
"""Of throws that end spinning or balanced, on no face."""
BOUNCING_COLOUR: Colour = (150, 150, 150)
"""Of throws that were stopped while they still bounced."""
NO_RELEASE_COLOUR: Colour = (255, 255, 255)
"""Of conditions at which no die can be released."""


def hex_colour(colour: Colour) -> str:
    """`#rrggbb`, as matplotlib and CSS write it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """`colour` with a `share` (0 to 1) of `other` in it."""
    red, green, blue = (round((1.0 - share) * a + share * b) for a, b in zip(colour, other, strict=True))
    return red, green, blue
