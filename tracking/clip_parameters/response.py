"""The camera's response from a clip whose scene does not give it: grey = light ** exponent, from how edges look.

Lens, motion and pixel average light. If grey levels follow a curve of it, a blurred edge is skewed and lies towards its darker
side, by more the more the two sides differ. With the curve undone, the edges of one rigid body fit their pictures better. Some
frames are mapped by each of several exponents, their poses refined, and the noise that is left is compared frame by frame, in
grey levels of the file: mapped levels have no unit in common. The gain of an exponent is the mean of ln s(1) - ln s, with s the
noise of a stretch of edge, or of the bevels and the contour of a well-rounded die. Frames that show the die from nearly the same
side share what the model does not know of it, marks and light: they count as one, and the standard error comes from the sides
that differ. A curve is undone if its gain is certain; most clips lose with either of two exponents, and need no more. The
exponent is the maximum of a parabola through the best that was tried and those beside it.

A well-rounded tetrahedron may be mistaken: the light on it is less of a polynomial than on other dice, and a curve makes up for
some of that.

How noise grows with the level is not used: grain of faces, codecs and denoising hide it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtr

from ...model.rotations import angle_between
from ..footage import Clip, level_grey, picture_in_light
from ..picture import (
    LOG_NOISE,
    NORMAL_MAD,
    PIXELS,
    View,
    new_equations,
    new_workspace,
    pixel_noise,
    whole_frame_windows,
)
from ..pose import SampledFrames, pose_state, refine_and_score, weak_prior

Array = NDArray[np.float64]
Looks = Callable[[int], SampledFrames]
"""At most so many frames with their poses."""

RESPONSE_FRAMES = 16
"""Frames that are used."""
MORE_FRAMES = 48
"""Frames that decide if one of the exponents gains on those: of few sides of a die some gain by chance."""
TRIED = (1.0, 0.75, 0.5)
"""Exponents that are tried, the linear response first."""
TRIED_FURTHER = (0.87, 0.62, 0.42)
"""Exponents that are tried if one of those gains. Displays have 0.4 to 0.5."""
FEWEST_FRAMES = 6
"""Frames below which nothing is said."""
FEWEST_SIDES = 2
"""Sides of the die that they show, below which nothing is said: a gain has an error from two on. So few hardly ever make a curve
certain, but may leave it open, where a clip without loss would count as linear."""
SAME_SIDE_RAD = 0.4
"""Rotation of a die over which frames show the same side of it."""
CERTAIN_SIGMAS = 3.0
"""Gain of an exponent over the linear response from which the curve is undone: standard errors where there are many sides, and
where there are few, as many as are exceeded as rarely by Student's distribution."""
UNKNOWN_SIGMA = 0.3
"""Standard deviation of the exponent of a response of which nothing is known: from a linear one, those for display, of 0.4 to
0.7, lie one or two of it away."""
LOSSLESS_CODECS = ("ffv1", "rawvideo", "huffyuv", "ffvhuff", "utvideo", "png", "magicyuv", "v210", "r210")
"""Codecs of FFmpeg that keep pictures as they are. Others smooth edges behind the curve, which then look as those of a linear
camera: of eleven random clips with a curve one was recognised, and five excluded theirs by three standard errors or more."""
GAINING_SIGMAS = 1.0
"""Gain of an exponent, in its standard errors, from which a clip without loss may have a curve after all. Below it is linear: an
unknown that its flights had to determine would cost the exact clips of measuring cameras most of their accuracy in depth."""
LEAST_SIGMA = 0.1
"""Least standard error of an exponent that is not 1: curves of cameras are no powers, and it is estimated with poses of single
pictures, which err by more than noise. Of two random clips it was off by 0.13 and 0.27. The flights estimate what is left of it:
with a standard error of 0.03 on the first of them the die was off by 3.4 mm, with 0.06 to 0.15 by 0.01 to 0.02 mm."""
DISTINCT_SIGMAS = 2.0
"""Standard errors from 1 beyond which an exponent is undone. The light on a well-rounded die is less of a polynomial than
assumed, and a slight curve makes up for that: of twelve linear cubes 0.87 gained on eight, and 0.84 was certain on one. It
remains an unknown."""
LEAST_GAIN = 1e-9
"""Least standard error of a gain."""
OUTLIER_DEVIATIONS = 3.0
"""Median absolute deviations to which the gain of a frame is limited."""
TRIED_SHADE_CHANGE = 0.3
"""Change of the shade beside the contour while exponents are compared, see `RefinementSettings`: a fifth of what poses are given.
On the profile of a contour a slope looks like a curve, and made a linear clip of a well-rounded die look like one of a curve."""
REFINED_STEPS = 8
"""Most steps of the refinement of a pose."""
REFINED_GAIN = 1e-3
"""Gain [squared sigmas] of the last of them."""


@dataclass(frozen=True)
class EstimatedResponse:
    """The exponent of a clip's response, grey = light ** exponent."""

    exponent: float
    """1 unless another explains the pictures better for certain."""
    sigma: float
    """Standard error."""

    @property
    def is_linear(self) -> bool:
        """Whether the clip is used as it is."""
        return self.exponent == 1.0

    @property
    def is_exact(self) -> bool:
        """Whether nothing was found that a person need know: a linear response, and certain."""
        return self.is_linear and self.sigma == 0.0

    @property
    def notice(self) -> str:
        """What was found, for the notes of a run."""
        if self.is_linear:
            return (
                "The response of the camera is neither stated nor shown by the pictures, grey = light ** "
                f"{self.exponent:.2f} ± {self.sigma:.2f}; the errors of all poses contain that: state it as `response` in [clip]."
            )
        return (
            f"Edges of the die show a display curve, grey = light ** {self.exponent:.2f} ± {self.sigma:.2f}, which was undone; "
            "if you know the response of the camera, state it as `response` in [clip]."
        )


def estimate_response(view: View, looks: Looks, clip: Clip) -> EstimatedResponse | None:
    """The response of a clip; None if too few frames show edges and the file is without loss.

    `looks` gives at most so many frames with their poses; these and `view` have the levels of `clip`."""
    trials = _Trials.of(view, looks(RESPONSE_FRAMES), clip)
    if trials is not None and trials.best_sigmas > 0.0:
        trials = _Trials.of(view, looks(MORE_FRAMES), clip)
    codec = clip.metadata().get("codec")
    is_lossy = codec is not None and codec not in LOSSLESS_CODECS
    if trials is None:
        # Cameras for measurements, which are linear, write files without loss.
        return EstimatedResponse(1.0, UNKNOWN_SIGMA) if is_lossy else None
    away, sigma = 1.0 - trials.best_exponent, trials.sigma_of(trials.best_exponent)
    if trials.is_certain and away > DISTINCT_SIGMAS * sigma:
        return EstimatedResponse(trials.best_exponent, sigma)
    if is_lossy:
        return EstimatedResponse(1.0, UNKNOWN_SIGMA)
    if trials.is_certain:
        return EstimatedResponse(1.0, max(away, sigma))
    return EstimatedResponse(1.0, trials.sigma_of(1.0) if trials.best_sigmas > GAINING_SIGMAS else 0.0)


@dataclass(frozen=True, eq=False)
class _Trials:
    """Frames mapped by several exponents."""

    exponents: Array
    """(m,) the linear response first, then in falling order."""
    gains: Array
    """(m, n) of each exponent on each of n sides of the die, means over frames; 0 for the linear response."""

    @staticmethod
    def of(view: View, frames: SampledFrames, clip: Clip) -> _Trials | None:
        """The trials of a clip; None if too few frames have poses with each of the exponents."""
        found = {exponent: _log_noise(view, frames, clip, exponent) for exponent in TRIED}
        first = np.array(list(found.values()))
        if np.isfinite(first).all(axis=0).sum() < FEWEST_FRAMES:
            return None
        if np.nanmean(first[0] - first[1:], axis=1).max() > 0.0:
            found |= {exponent: _log_noise(view, frames, clip, exponent) for exponent in TRIED_FURTHER}
        exponents = sorted(found, reverse=True)
        log_noise = np.array([found[exponent] for exponent in exponents])
        good = np.flatnonzero(np.isfinite(log_noise).all(axis=0))
        sides = _sides(frames.rotation[good])
        if len(sides) < FEWEST_SIDES:
            return None
        gains = _without_outliers(log_noise[0, good] - log_noise[:, good])
        return _Trials(np.array(exponents), np.stack([gains[:, side].mean(axis=1) for side in sides], axis=1))

    @property
    def sigmas(self) -> Array:
        """(m,) mean gains in their standard errors."""
        error = np.std(self.gains, axis=1, ddof=1) / np.sqrt(self.gains.shape[1])
        return np.asarray(self.gains.mean(axis=1) / np.maximum(error, LEAST_GAIN))

    @property
    def best_sigmas(self) -> float:
        """Gain of the best exponent that was tried in its standard errors."""
        return float(self.sigmas[np.argmax(self.gains.mean(axis=1))])

    @property
    def is_certain(self) -> bool:
        """Whether the best exponent that was tried explains the frames better for certain."""
        return float(stdtr(self.gains.shape[1] - 1, -self.best_sigmas)) < float(ndtr(-CERTAIN_SIGMAS))

    @property
    def best_exponent(self) -> float:
        """The maximum of the parabola through the best exponent that was tried and those beside it."""
        gains = self.gains.mean(axis=1)
        k = int(np.clip(np.argmax(gains), 1, len(gains) - 2))
        curvature, slope, _ = np.polyfit(self.exponents[k - 1 : k + 2], gains[k - 1 : k + 2], 2)
        if not curvature < 0.0:
            return float(self.exponents[np.argmax(gains)])
        return float(np.clip(-0.5 * slope / curvature, self.exponents[-1], 1.0))

    def sigma_of(self, exponent: float) -> float:
        """Standard error of an exponent: how far off those lie that explain the frames worse by a standard error of the
        difference."""
        off = np.abs(self.exponents - exponent)
        near = int(np.argmin(off))
        change = self.gains - self.gains[near]
        error = np.std(change, axis=1, ddof=1) / np.sqrt(change.shape[1])
        worse = np.maximum(-change.mean(axis=1) / np.maximum(error, LEAST_GAIN), 1e-9)
        sigma = float((off / worse)[np.arange(len(off)) != near].min())
        return float(np.clip(sigma, 0.0 if exponent == 1.0 else LEAST_SIGMA, UNKNOWN_SIGMA))


def _log_noise(view: View, frames: SampledFrames, clip: Clip, exponent: float) -> Array:
    """(n,) mean logarithm of the noise [grey levels of the file] that refined poses leave in frames mapped by an exponent, NaN
    where there is no pose."""
    backgrounds = np.array([picture_in_light(picture, clip, exponent) for picture in view.backgrounds])
    pictures = [picture_in_light(picture, clip, exponent).reshape(backgrounds.shape) for picture in frames.pictures]
    unit_grey = view.level_grey * level_grey(clip, exponent)
    noises = [pixel_noise([one[c] for one in pictures], backgrounds[c], unit_grey) for c in range(len(backgrounds))]
    view = replace(
        view,
        backgrounds=backgrounds,
        noise_grey=max(noise.noise_grey for noise in noises),
        rounding_grey=max(noise.rounding_grey for noise in noises),
        level_grey=unit_grey,
    )
    file_scale = float(2**clip.bit_depth - 1)
    full_scale = file_scale * level_grey(clip, exponent)
    settings = view.settings._replace(
        fine_steps=REFINED_STEPS, min_gain=REFINED_GAIN, region_pixels=0, response=exponent, full_scale=full_scale,
        file_scale=file_scale, saturation_grey=full_scale, shade_change=TRIED_SHADE_CHANGE,
    )  # fmt: skip
    log_noise = np.full(len(frames), np.nan)
    work, equations = new_workspace(view.shape, view.rig), new_equations()
    for k, picture in enumerate(pictures):
        start = pose_state(frames.position_m[k], frames.rotation[k], frames.motion[k, :3], frames.motion[k, 3:])
        windows, prior = whole_frame_windows(view, picture), weak_prior(view, start.position)
        work.shared_grey[:] = 0.0
        refine_and_score(windows, view.model(settings), start, prior, 0, work, equations)
        if equations.H.any() and equations.statistics[PIXELS] > 0:
            log_noise[k] = equations.statistics[LOG_NOISE] / equations.statistics[PIXELS]
    return log_noise


def _sides(rotations: Array) -> list[NDArray[np.int64]]:
    """Rows of rotations (n, 3, 3) in groups that follow each other while the die turns by SAME_SIDE_RAD."""
    groups: list[list[int]] = []
    for k, rotation in enumerate(rotations):
        if groups and angle_between(rotations[groups[-1][0]], rotation) < SAME_SIDE_RAD:
            groups[-1].append(k)
        else:
            groups.append([k])
    return [np.array(group) for group in groups]


def _without_outliers(gains: Array) -> Array:
    """Gains (exponents, n), each row limited to OUTLIER_DEVIATIONS about its median."""
    middle = np.median(gains, axis=1, keepdims=True)
    spread = OUTLIER_DEVIATIONS * NORMAL_MAD * np.median(np.abs(gains - middle), axis=1, keepdims=True)
    return np.asarray(np.clip(gains, middle - spread, middle + spread))
