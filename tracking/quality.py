"""How much work tracking spends on a frame: speed against accuracy, as a value that is passed down."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quality:
    """A choice between faster and finer."""

    name: str
    fine_steps: int
    """Most Gauss-Newton steps at the lens blur on one frame."""
    tracking_steps: int
    """The same while the die is only followed, where a second pass refines every pose again; twice as many for rounded dice."""
    tracking_stride: int
    """One pixel line in so many is walked while the die is only followed."""
    enough: float
    """Squared sigmas, of all six numbers together: a step that gains less is the last one, and leaves about a tenth of that."""
    settled_px: float
    """A step that moves no point of the die by more than this is the last one as well while the die is only followed, and
    along flights that marks have made far surer than a frame. What it leaves, about a tenth, pulls poses towards their
    prediction: along others final ones would scatter less than they err."""
    band_px: float
    """Least half-width of the band of pixels about an edge. The two greys beside an edge are not known: of what the pixels
    tell of its place 35 % are lost to them in a band of 3.5 pixels, 15 % in one of 8, where stretches are not alike. On faces of
    one grey poses then err by 5 % less; on wood, cork and paint they err more, whose grain is no noise."""
    judging_pixels: int
    """Pixels that judge a pose as a whole, faces and surroundings."""
    starts: int
    """Most first poses that race each other over the first frames."""
    rivals: int
    """Most other explanations that are tried on a frame which the motion so far does not explain: bounces, on each low corner
    with several strengths, then turns about the last pose. No die has as many as 128."""
    second_pass: bool
    """Refine every frame once more from its flight, which brings back frames that the first pass lost."""
    marks: bool
    """Use what is printed on the faces, where it helps; they are learned from what a second pass shows."""

    def __post_init__(self) -> None:
        """Raises ValueError for marks without a second pass."""
        if self.marks and not self.second_pass:
            raise ValueError(f"quality {self.name}: marks without a second pass; wanted both, or no marks")


FAST = Quality(
    "fast", fine_steps=2, tracking_steps=2, tracking_stride=2, enough=0.5, settled_px=0.1, band_px=3.5, judging_pixels=400,
    starts=24, rivals=128, second_pass=False, marks=False,
)  # fmt: skip
STANDARD = Quality(
    "standard", fine_steps=4, tracking_steps=2, tracking_stride=2, enough=0.5, settled_px=0.1, band_px=3.5, judging_pixels=800,
    starts=24, rivals=128, second_pass=True, marks=True,
)  # fmt: skip
FINE = Quality(
    "fine", fine_steps=8, tracking_steps=4, tracking_stride=1, enough=1e-3, settled_px=0.0, band_px=3.5, judging_pixels=2500,
    starts=24, rivals=128, second_pass=True, marks=True,
)  # fmt: skip
QUALITIES = {quality.name: quality for quality in (FAST, STANDARD, FINE)}
