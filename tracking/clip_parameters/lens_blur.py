"""The lens blur of a clip, from the edges of the die on frames with known poses.

Each frame gives a Newton step of the blur and its information (`blur_step`); the common blur takes their weighted
mean, and the steps are repeated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..picture import PoseState, View
from ..pose import SampledFrames, blur_step

LEAST_BLUR_PX = 0.3
"""Least blur: that of a pixel by itself."""
MOST_BLUR_PX = 6.0
"""Largest blur with which a picture still determines a pose."""
BLUR_FRAMES = 16
"""Frames on which it is estimated."""
STEPS = 4
"""Most Newton steps."""
OUTLIER_DEVIATIONS = 3.0
"""Median absolute deviations from the median step beyond which a frame is left out."""
LEAST_DEVIATION_PX = 0.01
"""Least median absolute deviation that is assumed for that."""
MOST_DECREASE = 0.3
"""Largest decrease in one step, as a share of the blur."""
MOST_INCREASE = 0.5
"""Largest increase in one step, as a share of the blur."""
CONVERGED_PX = 2e-3
"""A smaller step is the last."""


def estimate_lens_blur(view: View, frames: SampledFrames) -> float:
    """The lens blur [px] that fits the frames best; that of the view if they do not determine it.

    Each frame is weighted by its information, and outliers are left out.
    """
    for _ in range(STEPS):
        poses = zip(frames.pictures, frames.position_m, frames.rotation, frames.motion, strict=True)
        steps = np.array(
            [blur_step(view, picture, PoseState(p, R, motion[:3], motion[3:])) for picture, p, R, motion in poses]
        )
        deviation = np.abs(steps[:, 0] - np.median(steps[:, 0]))
        near = deviation <= OUTLIER_DEVIATIONS * max(float(np.median(deviation)), LEAST_DEVIATION_PX)
        weight = np.where(near, steps[:, 1], 0.0)
        if not weight.sum() > 0.0:
            break
        mean = weight @ steps[:, 0] / weight.sum()
        change = float(np.clip(mean, -MOST_DECREASE * view.blur_px, MOST_INCREASE * view.blur_px))
        view = replace(view, blur_px=float(np.clip(view.blur_px + change, LEAST_BLUR_PX, MOST_BLUR_PX)))
        if abs(change) < CONVERGED_PX:
            break
    return view.blur_px
