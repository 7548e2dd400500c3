"""The response of a camera from edges of the die: `python benchmarks/responses.py [--clips 48] [--seed 1]`.

Each of the random clips of `population.py` is taken as if its scene did not give the response, and its exponent (grey =
light ** exponent, `tracking.clip_parameters.response`) is estimated from true poses. A line for each clip with the true
response, the codec, the estimate with its standard error, and seconds; then how many clips with a display curve are
recognised, how many linear ones are mistaken, and the root mean square error of exponents in their standard errors. The sRGB
curve counts as the exponent 0.45. Clips are rendered where they are missing in `--cache`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from population import rendered_clip
from population_clips import draw_clip
from single_frames import over_clips, true_poses, view_of

from diethrow.tracking.clip_parameters import BLUR_FRAMES, EstimatedResponse, estimate_lens, estimate_response
from diethrow.tracking.picture import with_lens

SRGB_EXPONENT = 0.45
"""Exponent that is nearest to the sRGB curve."""


@dataclass(frozen=True)
class Found:
    """The estimate of one clip."""

    number: int
    true: str | float
    codec: str
    response: EstimatedResponse | None
    seconds: float

    @property
    def exponent(self) -> float:
        """The true one."""
        named = {"linear": 1.0, "srgb": SRGB_EXPONENT}
        return named[self.true] if isinstance(self.true, str) else self.true

    @property
    def line(self) -> str:
        """As it is printed."""
        found = (
            "too few frames" if self.response is None else f"{self.response.exponent:.2f} ± {self.response.sigma:.2f}"
        )
        return f"{self.number:4d}  {self.true!s:7s} {self.codec:6s} {found:15s} {self.seconds:5.1f} s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Render, estimate, and print the lines."""
    found = over_clips(__doc__, arguments, estimated)
    for one in sorted(found, key=lambda each: each.number):
        print(one.line)
    known = [(one, one.response) for one in found if one.response is not None]
    for name, some in (
        ("display curves", [pair for pair in known if pair[0].exponent != 1.0]),
        ("linear clips", [pair for pair in known if pair[0].exponent == 1.0]),
    ):
        undone = [(one, response) for one, response in some if not response.is_linear]
        sigmas = [(response.exponent - one.exponent) / response.sigma for one, response in undone]
        error = f", error {np.sqrt(np.mean(np.square(sigmas))):.1f} standard errors" if sigmas else ""
        print(f"{name}: {len(some)}, taken for curves: {len(undone)}{error}")
    return 0


def estimated(clips: Path, seed: int, number: int) -> Found:
    """The estimate of one clip."""
    draw = draw_clip(seed, number)
    folder = rendered_clip(clips, draw, number)
    view, source = view_of(folder, states_response=False)
    poses, clip = true_poses(folder, view, len(source)), source.clips[0]
    view = with_lens(view, estimate_lens(view, poses.sample(source.frame, poses.known, BLUR_FRAMES)))
    begun = time.perf_counter()
    response = estimate_response(view, lambda most: poses.sample(source.frame, poses.known, most), clip)
    return Found(number, draw.response, draw.codec, response, time.perf_counter() - begun)


if __name__ == "__main__":
    sys.exit(main())
