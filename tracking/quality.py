"""Speed against accuracy of tracking, as a value that is passed down.

All qualities use the same model of the picture; they differ in how much work they spend on it:

- `standard` tracks the die frame to frame, refines every frame again from its flight, and uses surface marks where they
  help;
- `fast` stops after frame-to-frame tracking. It drops the second pass (frames that the first one lost stay lost, poses
  keep the
  error of their last steps), surface marks, and half of the pixels that score a pose;
- `fine` takes steps until nothing changes, walks every pixel line, and scores a pose on three times as many pixels.

`diethrow trade` measures on a scene what each number costs and gains.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..model.errors import InputError


@dataclass(frozen=True)
class Quality:
    """How much work tracking spends on a frame."""

    name: str
    fine_steps: int
    """Most Gauss-Newton steps of a refinement on one frame, at the lens blur."""
    tracking_steps: int
    """The same during frame-to-frame tracking, where a second pass refines every pose again; twice as many for rounded
    dice."""
    tracking_line_stride: int
    """Frame-to-frame tracking uses one pixel line in so many."""
    min_gain: float
    """[squared sigmas], of all six numbers of a pose together. A step that gains less is the last; it leaves about a
    tenth."""
    min_step_px: float
    """A step that moves no point of the die by more than this is the last as well, during frame-to-frame tracking and
    along flights that marks have made much more certain than a frame. What it leaves, about a tenth, biases poses
    towards their prediction: along other flights, final poses would scatter by less than their errors."""
    band_px: float
    """Least half-width of the band of pixels about an edge. The two grey levels beside an edge are unknown. This costs
    35 % of the information on its place in a band of 3.5 px, and 15 % in one of 8 px. With 8 px, poses of faces of one
    grey err by 5 % less; on wood, cork and paint they err by more, because their grain is not noise."""
    region_pixels: int
    """Pixels on which the cost of a whole pose is computed, faces and surroundings."""
    max_initial_poses: int
    """Most initial poses that are tracked and compared over the first frames."""
    max_hypotheses: int
    """Most hypotheses that are tested on a frame that the motion so far does not explain: bounces, on each low corner
    with several strengths, then turns about the last pose. No die has as many as 128."""
    second_pass: bool
    """Refine every frame again from its flight, which also recovers frames that the first pass lost."""
    marks: bool
    """Use the marks on the faces where they help; they are learned from the poses of a second pass."""

    def __post_init__(self) -> None:
        """Raises ValueError for marks without a second pass."""
        if self.marks and not self.second_pass:
            raise InputError(f"quality {self.name}: marks = true without a second pass; wanted both, or no marks")


FAST = Quality(
    "fast", fine_steps=2, tracking_steps=2, tracking_line_stride=2, min_gain=0.5, min_step_px=0.1, band_px=3.5,
    region_pixels=400, max_initial_poses=24, max_hypotheses=128, second_pass=False, marks=False,
)  # fmt: skip
STANDARD = Quality(
    "standard", fine_steps=4, tracking_steps=2, tracking_line_stride=2, min_gain=0.5, min_step_px=0.1, band_px=3.5,
    region_pixels=800, max_initial_poses=24, max_hypotheses=128, second_pass=True, marks=True,
)  # fmt: skip
FINE = Quality(
    "fine", fine_steps=8, tracking_steps=4, tracking_line_stride=1, min_gain=1e-3, min_step_px=0.0, band_px=3.5,
    region_pixels=2500, max_initial_poses=24, max_hypotheses=128, second_pass=True, marks=True,
)  # fmt: skip
QUALITIES = {quality.name: quality for quality in (FAST, STANDARD, FINE)}
