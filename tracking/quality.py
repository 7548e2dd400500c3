"""How much work tracking spends on a frame: speed against accuracy, as a value that is passed down."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quality:
    """A choice between faster and finer."""

    name: str
    fine_steps: int
    """Most Gauss-Newton steps at the lens blur on one frame."""
    judging_pixels: int
    """Pixels that judge a pose as a whole, faces and surroundings."""
    second_pass: bool
    """Refine every frame once more from its flight, which brings back frames that the first pass lost."""
    marks: bool
    """Use what is printed on the faces, where it helps."""


FAST = Quality("fast", fine_steps=2, judging_pixels=400, second_pass=False, marks=False)
STANDARD = Quality("standard", fine_steps=4, judging_pixels=800, second_pass=True, marks=True)
FINE = Quality("fine", fine_steps=8, judging_pixels=2500, second_pass=True, marks=True)
QUALITIES = {quality.name: quality for quality in (FAST, STANDARD, FINE)}
