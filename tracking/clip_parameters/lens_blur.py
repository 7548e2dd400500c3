"""The lens blur, as the edges of a die show it on frames whose poses are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..picture import View
from ..pose import SampledFrames, blur_step

LEAST_BLUR_PX, MOST_BLUR_PX = 0.3, 6.0
"""A sharper picture than a pixel can show, and one too blurred to tell a pose."""
BLUR_FRAMES = 16
"""Frames over which it is estimated."""


def estimate_lens_blur(view: View, looks: SampledFrames) -> float:
    """The lens blur [px] that fits some frames best: Newton steps on their common blur, each frame weighted by what it says of
    it, frames far from the others left out. That of the view where they say nothing."""
    for _ in range(4):
        steps = np.array(
            [
                blur_step(view, picture, position_m, rotation, motion[:3], motion[3:])
                for picture, position_m, rotation, motion in zip(
                    looks.pictures, looks.position_m, looks.rotation, looks.motion, strict=True
                )
            ]
        )
        far = np.abs(steps[:, 0] - np.median(steps[:, 0]))
        weight = np.where(far <= 3.0 * max(float(np.median(far)), 0.01), steps[:, 1], 0.0)
        if not weight.sum() > 0.0:
            break
        change = float(np.clip(weight @ steps[:, 0] / weight.sum(), -0.3 * view.blur_px, 0.5 * view.blur_px))
        view = replace(view, blur_px=float(np.clip(view.blur_px + change, LEAST_BLUR_PX, MOST_BLUR_PX)))
        if abs(change) < 2e-3:
            break
    return view.blur_px
