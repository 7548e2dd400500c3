"""The lens of a clip, from the edges of the die on frames with known poses: its blur, and its depth of field if the clip shows
one.

Each frame gives a Newton step of the blur at its depth and its information (`blur_step`). The common blur takes their weighted
mean, and the steps are repeated. If the blur of the frames then depends on their depth beyond chance, it is that of a thin lens:
with the diameter D, in focus at z₀, and the focal length f [px],

    σ(z)² = σ₀² + (D f/4)² (1/z - 1/z₀)²,

a parabola in 1/z. It has two numbers more than one blur, which must gain as much as chance does once in a hundred thousand clips.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from ..picture import Lens, PoseState, View, with_lens
from ..pose import SampledFrames, blur_step

Array = NDArray[np.float64]

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
FEWEST_FRAMES = 8
"""Frames below which no depth of field is looked for."""
LEAST_DEPTH_CHANGE = 0.02
"""Range of the depths, over their mean, below which none is looked for: a lens of 40 mm changes its blur by 0.8 px
there, in pictures of dice of 16 mm at 67 px."""
CHANCE = 1e-5
"""Probability with which frames of one blur seem to have a depth of field."""
LEAST_CHANGE = 0.1
"""Least change of the blur over the frames, as a share of it, that is worth two numbers: edges are located as well with a blur
that is wrong by a few per cent."""
REWEIGHTINGS = 4
"""Fits of a depth of field, each without the outliers of the one before."""
OWN_STEPS = 8
"""Most Newton steps of the blur of one frame by itself."""
OWN_CONVERGED = 0.02
"""Relative change by the last of them."""
BLUR_ERROR_SHARE = 0.03
"""Standard deviation of the blur of a frame beyond noise, as a share of it: a defocused point is a disc, and no Gaussian."""


def estimate_lens(view: View, frames: SampledFrames) -> Lens:
    """The lens that fits the frames best; that of the view if they do not determine it. Of a view with a depth of field this is
    estimated again where the frames show one, and stays otherwise.

    Each frame is weighted by its information, and outliers are left out."""
    if view.lens.aperture_m > 0.0 and (again := depth_of_field(view, frames)) is not None:
        return again
    for _ in range(STEPS):
        steps = _blur_steps(view, frames)
        near = _without_outliers(steps[:, 0], LEAST_DEVIATION_PX)
        weight = np.where(near, steps[:, 1], 0.0)
        if not weight.sum() > 0.0:
            break
        mean = weight @ steps[:, 0] / weight.sum()
        change = float(np.clip(mean, -MOST_DECREASE * view.blur_px, MOST_INCREASE * view.blur_px))
        view = with_lens(view, replace(view.lens, blur_px=_within_limits(view.blur_px + change)))
        if abs(change) < CONVERGED_PX:
            break
    return view.lens


def depth_of_field(view: View, frames: SampledFrames) -> Lens | None:
    """The lens whose blur depends on depth as that of the frames does; None if one blur suffices, if the die hardly changes its
    depth, or before several cameras."""
    depth_m = np.asarray((frames.position_m - view.camera.centre_m) @ view.camera.rotation[2])
    if len(view.cameras) > 1 or len(depth_m) < FEWEST_FRAMES or np.ptp(depth_m) < LEAST_DEPTH_CHANGE * depth_m.mean():
        return None
    one = with_lens(view, Lens(view.blur_px))
    steps = _blur_steps(one, frames)
    seen = steps[steps[:, 1] > 0.0, 0]
    if len(seen) < FEWEST_FRAMES or np.subtract(*np.percentile(seen, [90, 10])) < LEAST_CHANGE * view.blur_px:
        return None
    blurs = np.array([_own_blur(one, frames, k) for k in range(len(frames))])
    return _thin_lens(depth_m, blurs, float(view.camera.matrix[0, 0]))


def _blur_steps(view: View, frames: SampledFrames) -> Array:
    """(n, 2) Newton step [px] of the blur at the depth of each frame, and its information [1/px²]."""
    return np.array([_blur_step(view, frames, k) for k in range(len(frames))])


def _blur_step(view: View, frames: SampledFrames, k: int) -> tuple[float, float]:
    """That of one frame."""
    motion = frames.motion[k]
    pose = PoseState(frames.position_m[k], frames.rotation[k], motion[:3], motion[3:])
    return blur_step(view, frames.pictures[k], pose)


def _own_blur(view: View, frames: SampledFrames, k: int) -> tuple[float, float]:
    """The blur [px] of one frame by itself, and its information [1/px²]; 0 if it has none."""
    blur_px, information = view.blur_px, 0.0
    for _ in range(OWN_STEPS):
        step, information = _blur_step(with_lens(view, Lens(blur_px)), frames, k)
        change = float(np.clip(step, -MOST_DECREASE * blur_px, MOST_INCREASE * blur_px))
        blur_px = _within_limits(blur_px + change)
        if abs(change) < OWN_CONVERGED * blur_px:
            break
    return blur_px, information


def _without_outliers(values: Array, least: float) -> NDArray[np.bool_]:
    """(n,) those that lie near their median; their median absolute deviation is taken to be `least` at least."""
    deviation = np.abs(values - np.median(values))
    return np.asarray(deviation <= OUTLIER_DEVIATIONS * max(float(np.median(deviation)), least))


def _within_limits(blur_px: float) -> float:
    return float(np.clip(blur_px, LEAST_BLUR_PX, MOST_BLUR_PX))


def _thin_lens(depth_m: Array, blurs: Array, focal_px: float) -> Lens | None:
    """The lens of frames at some depths (n,) whose blurs and information (n, 2) are known; None if one blur explains them."""
    use = (blurs[:, 1] > 0.0) & (blurs[:, 0] < MOST_BLUR_PX)
    if use.sum() < FEWEST_FRAMES:
        return None
    blur_px, nearness = blurs[use, 0], 1.0 / depth_m[use]
    # Of the square σ² the standard error is 2 σ times that of σ.
    sigma_px = np.hypot(1.0 / np.sqrt(blurs[use, 1]), BLUR_ERROR_SHARE * blur_px)
    square, weight = blur_px**2, 1.0 / (2.0 * blur_px * sigma_px)
    middle, width = nearness.mean(), float(np.ptp(nearness))
    x = (nearness - middle) / width
    near = np.ones(len(x), bool)
    for _ in range(REWEIGHTINGS):
        curve = np.polyfit(x[near], square[near], 2, w=weight[near])
        near = _without_outliers(weight * (square - np.polyval(curve, x)), 1.0)
        if near.sum() < FEWEST_FRAMES:
            return None
    one = np.average(square[near], weights=weight[near] ** 2)
    alone, left = (float(((weight * (square - mean))[near] ** 2).sum()) for mean in (one, np.polyval(curve, x)))
    free = int(near.sum()) - 3
    gain = 0.5 * (alone - left) / max(left / free, 1e-300)
    lowest = -0.5 * curve[1] / curve[0] if curve[0] > 0.0 else np.nan
    nearness_in_focus = middle + width * lowest
    if not nearness_in_focus > 0.0 or fdtrc(2, free, max(gain, 0.0)) > CHANCE:
        return None
    sharpest_px = _within_limits(float(np.sqrt(max(float(np.polyval(curve, lowest)), 0.0))))
    return Lens(sharpest_px, 4.0 * float(np.sqrt(curve[0])) / width / focal_px, float(1.0 / nearness_in_focus))
