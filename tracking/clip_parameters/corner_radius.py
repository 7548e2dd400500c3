"""The corner radius of a die that nobody has measured: the radius with which the pictures are explained best.

The die is modelled with several radii r, and the negative log-likelihood per pixel of the edge model is compared
frame by frame,

    ℓ(r) = (c²/6 Σ ρ + Σ ln s + 2 K)/n,

with the biweight's cost ρ of cut c in units of a Gaussian's, the noise s of every stretch of edge, and the two more
intensities of each stretch of a rounded edge (Akaike's penalty for K parameters). It is a mean over pixels because a
rounded edge is broader and has more of them. Three questions are answered, each on some frames spread over the clip:

1. **Is the die rounded at all?** The pose of each frame is free. The contour of a rounded die lies up to 0.4 r inside
   that of the sharp one, which a larger distance imitates. It does not imitate strips of their own shade between the
   faces, or contours that are displaced beside some faces only. `is_rounded` is true if ℓ falls by more than any
   sharp die's, and significantly.
2. **About how much?** ℓ over increasing radii, with free poses (`radius_by_free_poses`). Oblique light moves the
   apparent contour inwards by a tenth of a pixel, the poses follow, and the minimum of ℓ lies at a radius too small
   by up to two thirds. The far shoulder of the minimum is nearer to the truth, and good enough for a first model of
   the flights. From two pixels on the whole surface says more (`radius_by_surface`).
3. **How much?** In flight the die falls with g and bounces on z = 0, which determines its distance. The minimum of ℓ
   is taken with the poses of the flights, none free (`radius_on_flights`).

A wrong radius leaves a contour error that is common to all frames. The flights correct it if its prior is wide
enough: `contour_sigma_px` gives that prior, and goes with the track. Sharp dice need the first question alone. Sharp
and rounded dice are compared by the same equations, on the same ends of the edges: sharp is a radius of SHARP_PX.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, largest_corner_radius
from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..picture import (
    BIWEIGHT_CUT,
    LOG_NOISE,
    NORMAL_MAD,
    PIXELS,
    ROBUST_COST,
    STRETCHES,
    THREADS,
    PoseState,
    RefinementSettings,
    View,
    new_equations,
    new_workspace,
    shares_in_view,
    strips_of_any_shade,
    whole_frame_windows,
    with_corner_radius,
)
from ..pose import Picture, SampledFrames, refine_and_score, weak_prior
from ..throw import flights_only, outline_growth
from ..track import Track

Array = NDArray[np.float64]

RADIUS_FRAMES = 24
"""Frames that are used: the standard error of their mean is a fifth of one frame's."""
MORE_FRAMES = 72
"""Frames that are used if those leave the first question open."""
SHARP_PX = 0.02
"""Radius of a sharp die in the equations of a rounded one, on the same pixels: strips of this width are invisible."""
TESTED_PX = 1.0
"""Radius that is compared with a sharp die at the lens blur TESTED_BLUR_PX; in proportion at a larger blur. At 2.4 px
of blur a sharp tetrahedron is explained better by strips of one pixel, because of what the blur of its corners does
to the edges beside them."""
TESTED_BLUR_PX = 0.7
"""Lens blur at which a radius of TESTED_PX is visible."""
ROUND_TESTED_PX = 4.0
"""Radius that is compared first: a die so round that TESTED_PX makes no difference. It grows with the blur as well."""
ROUND_FRAMES = 8
"""Frames of that comparison, which shows more on each."""
LEAST_GAIN = 0.02
"""Least fall of ℓ for a die to be taken for rounded."""
CLEAR_GAIN = 0.09
"""The same for a die that edges alone show rounded: of sharp ones of a codec three showed 0.07 to 0.086, and one without a
codec 0.03; of four dice rounded by 1.2 to 1.3 px two show 0.11 and 0.34, and two 0.055 and 0.07."""
SIGNIFICANT_SIGMAS = 2.0
"""Standard errors by which a fall of ℓ differs significantly from LEAST_GAIN, and from none."""
WINSOR_SIGMAS = 3.0
"""Distance from the median, in standard deviations by the median deviation, at which a frame's ℓ is clipped."""
LEAST_RADIUS_PX = 0.5
"""First radius that is tried."""
RADIUS_RATIO = 1.4
"""Ratio of successive radii."""
MOST_INRADIUS_SHARE = 0.6
"""Largest radius that is tried, as a share of the inscribed radius."""
SAFE_SHARE = 0.95
"""The same, as a share of the largest radius that leaves every face of the solid."""
MOST_RISE = 0.15
"""Rise of ℓ above its minimum from which larger radii are not tried."""
SHOULDER = 0.9
"""Share of the greatest gain. With free poses ℓ has a broad and skew minimum at 0.3 to 0.9 times the true radius: a
larger distance compensates for a radius that is too small, and nothing for one that is too large. On rendered clips
this shoulder lies at 0.7 to 1.1 times."""
MOST_FREE_GAIN = 0.3
"""Fall of ℓ from the pose of the flight to the free pose of a frame beyond which the flight is wrong there."""
NEAR_RATIO = 1.25
"""Ratio of successive radii about a first one that are tried on flights."""
NEAR_STEPS = 5
"""Radii to either side of the first one: up to three times as large, and as small."""
FREE_SIGMA_SHARE = 0.25
"""Standard deviation of a radius by free poses, as a share of it."""
FREE_SIGMA_PX = 0.3
"""Standard deviation of any radius by free poses, besides."""
FLIGHT_SIGMA_SHARE = 0.15
"""Standard deviation of a radius on flights, as a share of it. With the true poses of rendered clips the minimum lies
at 0.8 to 1.1 times the true radius: how far down a bevel an edge seems to lie depends on the light."""
FLIGHT_SIGMA_PX = 0.1
"""Standard deviation of any radius on flights, besides."""
LEAST_INSET_SHARE = 0.02
"""Least displacement of an outline over the radius: a die that always shows a face to the camera has none."""
NEAR_IMPACT_FRAMES = 1.5
"""Frames from an impact within which flights are not trusted."""
FEWEST_FRAMES = 6
"""Frames below which nothing is estimated."""
FREE_STEPS = 6
"""Most refinement steps of a free pose."""
FREE_LAST_GAIN = 0.01
"""A step that gains less [squared sigmas] is the last."""
FREE_STRIP_SHARE = 0.5
"""Prior on the shade of strips for this comparison (see `RefinementSettings`): wide, so that strips of any shade are
possible."""
STRETCH_INTENSITIES = 2.0
"""Additional intensities of each stretch of a rounded edge."""


class CornerRounding(StrEnum):
    """What is known in advance about the corner radius."""

    GIVEN = "given"
    """The die has the radius that it states."""
    TESTED = "tested"
    """The die is sharp unless the pictures clearly show it rounded."""
    ESTIMATED = "estimated"
    """The die is rounded, and its radius is to be estimated."""


@dataclass(frozen=True)
class CornerRadius:
    """The corner radius that the pictures show, or the impacts."""

    radius_m: float
    sigma_m: float
    """Standard error, the light on the bevels included."""
    by_impacts: bool = False
    """Whether impacts show it, of a die that looks sharp."""

    @property
    def notice(self) -> str:
        """One sentence for the reader of the result."""
        if self.radius_m == 0.0:
            return f"the corners look sharp: no radius was found, ± {1e3 * self.sigma_m:.2f} mm."
        shown = "the corners look rounded,"
        if self.by_impacts:
            shown = "the corners look sharp, but strike the table as rounded ones do,"
        return (
            f"{shown} with a radius of {1e3 * self.radius_m:.2f} ± {1e3 * self.sigma_m:.2f} mm, which the poses take into "
            "account; if you have measured it, write it as die.corner_radius_m."
        )


# --- the three questions ----------------------------------------------------------------------------------------------


def compared_radius_px(view: View) -> float:
    """Radius [px] that is compared with a sharp die at the lens blur of a view."""
    return TESTED_PX * max(1.0, view.blur_px / TESTED_BLUR_PX)


def largest_radius_m(die: Die) -> float:
    """The largest radius [m] that is tried: more leaves a ball, or lets a face vanish."""
    return min(MOST_INRADIUS_SHARE * die.solid.inradius, SAFE_SHARE * largest_corner_radius(die.solid))


def rounding_gain(view: View, frames: SampledFrames, radius_px: float) -> tuple[float, float]:
    """Mean fall of ℓ from sharp corners to corners of this radius, with outliers clipped, and its standard error.

    It is (0, infinite) for fewer than FEWEST_FRAMES, and for a radius of so few pixels of die that it would be a ball.
    """
    if len(frames) < FEWEST_FRAMES:
        return 0.0, np.inf
    px_per_m = scale_px_per_m(view, frames)
    radius_m = radius_px / px_per_m
    if radius_m > largest_radius_m(view.die):
        return 0.0, np.inf
    settings = _free_poses(view)
    sharp, round_ = (
        _misfits(with_corner_radius(view, r), frames, settings)[0] for r in (SHARP_PX / px_per_m, radius_m)
    )
    return winsorised_mean(sharp - round_)


def gain_over_sharp(view: View, radius_m: float, sharp: SampledFrames, rounded: SampledFrames) -> tuple[float, float]:
    """Mean fall of ℓ from sharp corners to corners of a radius, and its standard error, each at the poses of a track of its own,
    on the same pictures."""
    settings = _free_poses(view)
    before = _misfits(with_corner_radius(view, SHARP_PX / scale_px_per_m(view, sharp)), sharp, settings)[0]
    return winsorised_mean(before - _misfits(with_corner_radius(view, radius_m), rounded, settings)[0])


def is_rounded(view: View, frames: Callable[[int], SampledFrames]) -> bool:
    """Whether the die of a view with sharp corners is clearly rounded; `frames(count)` gives at most `count` frames."""
    sampled, tested_px = frames(RADIUS_FRAMES), compared_radius_px(view)
    gain, sigma = rounding_gain(view, sampled.sample(ROUND_FRAMES), ROUND_TESTED_PX / TESTED_PX * tested_px)
    if gain > max(LEAST_GAIN, SIGNIFICANT_SIGMAS * sigma):
        return True
    gain, sigma = rounding_gain(view, sampled, tested_px)
    if abs(gain - LEAST_GAIN) < SIGNIFICANT_SIGMAS * sigma < np.inf:
        gain, sigma = rounding_gain(view, frames(MORE_FRAMES), tested_px)
    return gain > max(LEAST_GAIN, SIGNIFICANT_SIGMAS * sigma)


def is_clearly_rounded(view: View, frames: SampledFrames) -> bool:
    """Whether edges alone show that the die of a view with sharp corners is rounded, whatever a codec does to edges."""
    return rounding_gain(view, frames, compared_radius_px(view))[0] > CLEAR_GAIN


def radius_by_free_poses(view: View, frames: SampledFrames) -> CornerRadius | None:
    """The largest radius that keeps SHOULDER of the greatest gain over sharp corners, the pose of each frame being
    free.

    0 if no radius gains, None for fewer than FEWEST_FRAMES.
    """
    if len(frames) < FEWEST_FRAMES:
        return None
    px_per_m, settings = scale_px_per_m(view, frames), _free_poses(view)
    largest = largest_radius_m(view.die)
    sharp, refined = _misfits(with_corner_radius(view, SHARP_PX / px_per_m), frames, settings)
    radii, gains = [0.0], [0.0]
    radius = LEAST_RADIUS_PX / px_per_m
    while radius < largest and gains[-1] > max(gains) - MOST_RISE:
        # Start from the poses of the previous radius: a rounder die of the same outline is nearer.
        misfit, refined = _misfits(with_corner_radius(view, radius), refined, settings)
        radii.append(radius)
        gains.append(winsorised_mean(sharp - misfit)[0])
        radius *= RADIUS_RATIO
    found = _far_shoulder(np.array(radii), np.array(gains))
    return CornerRadius(found, float(np.hypot(FREE_SIGMA_SHARE * found, FREE_SIGMA_PX / px_per_m)))


def radius_on_flights(
    view: View, frames: SampledFrames, first_m: float, contour_px: float = 0.0
) -> CornerRadius | None:
    """The radius of minimum ℓ about a first one, at the poses of the frames as they are.

    `contour_px` is the standard error of the contour that the flights leave: that of their distance, in pixels of the
    outline. 0 if no radius is better than sharp corners, None for fewer than FEWEST_FRAMES.
    """
    if len(frames) < FEWEST_FRAMES:
        return None
    px_per_m = scale_px_per_m(view, frames)
    first_m = max(first_m, LEAST_RADIUS_PX / px_per_m)
    near = np.minimum(first_m * NEAR_RATIO ** np.arange(-NEAR_STEPS, NEAR_STEPS + 1.0), largest_radius_m(view.die))
    radii = np.unique(np.append(SHARP_PX / px_per_m, near))
    free, fixed = _free_poses(view), _free_poses(view)._replace(fine_steps=1)
    first = with_corner_radius(view, first_m)
    free_gain = _misfits(first, frames, fixed)[0] - _misfits(first, frames, free)[0]
    misfits = np.array([_misfits(with_corner_radius(view, r), frames, fixed)[0] for r in radii]).T
    misfits = misfits[np.isfinite(misfits).all(1) & (free_gain < MOST_FREE_GAIN)]
    n = len(misfits)
    if n < FEWEST_FRAMES:
        return None
    best = _minimum(radii, misfits)
    without = np.array([_minimum(radii, np.delete(misfits, k, 0)) for k in range(n)])
    jackknife = np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum())
    inset = contour_sigma_px(view, 1.0, frames.position_m, frames.rotation)
    by_distance = contour_px / max(inset, LEAST_INSET_SHARE * px_per_m)
    errors = (jackknife, FLIGHT_SIGMA_SHARE * best, FLIGHT_SIGMA_PX / px_per_m, by_distance)
    return CornerRadius(best, float(np.linalg.norm(errors)))


def sample_in_flight(view: View, picture: Picture, track: Track, throw: Throw) -> SampledFrames:
    """RADIUS_FRAMES of a track that show the whole die on its flights, at the poses of the flights."""
    throw = flights_only(throw)
    spacing_s = float(np.median(np.diff(track.time_s)))
    impacts_s = np.array([impact.time_s for impact in throw.impacts])
    near = np.abs(track.time_s[:, None] - impacts_s).min(1, initial=np.inf) < NEAR_IMPACT_FRAMES * spacing_s
    rows = np.flatnonzero(track.tracked & ~near & (track.time_s <= throw.flights[-1].end_s))
    position, quaternion = throw.poses(track.time_s[rows])
    rotation, motion = matrix_from_quat(quaternion), throw.rates(track.time_s[rows])
    whole = shares_in_view(view, position, rotation) == 1.0
    return SampledFrames.at(rows[whole], picture, position[whole], rotation[whole], motion[whole], RADIUS_FRAMES)


def contour_sigma_px(view: View, radius_sigma_m: float, position_m: Array, rotation: Array) -> float:
    """Standard deviation [px] of the contour error common to all frames that a radius of standard deviation
    `radius_sigma_m` leaves at poses (n, 3), (n, 3, 3).

    From a silhouette of area A and perimeter P about an inscribed radius ρ, corners of radius r remove r (2 A/ρ - P),
    so that the outline moves inwards by r (2 A/(P ρ) - 1) on average.
    """
    growth = outline_growth(view.camera, view.die, position_m, rotation)
    known = growth > 0.0
    if not known.any():
        return 0.0
    distance = np.linalg.norm(position_m[known] - view.camera.centre_m, axis=1)
    px_per_m = view.camera.matrix[0, 0] / distance
    inset = 1.0 / (growth[known] * view.die.solid.inradius * px_per_m) - 1.0
    return float(np.median(inset * px_per_m) * radius_sigma_m)


# --- the misfit of a radius -------------------------------------------------------------------------------------------


def _free_poses(view: View) -> RefinementSettings:
    """Settings of a refinement with a free pose and strips of any shade, whatever is known of the light."""
    free = strips_of_any_shade(len(view.rig.camera))
    return view.settings._replace(
        fine_steps=FREE_STEPS,
        min_gain=FREE_LAST_GAIN,
        region_pixels=0,
        strip_prior_share=FREE_STRIP_SHARE,
        light=free,
        whole_surface=False,
    )


def _misfits(view: View, frames: SampledFrames, settings: RefinementSettings) -> tuple[Array, SampledFrames]:
    """ℓ of each frame (n,) for the radius of the view's die, NaN if no edge is visible, and the frames at the refined
    poses.

    Mirror images are not used: bevels in them are lit from below.
    """
    direct = (np.arange(len(view.rig.weight)) < len(view.cameras)).astype(float)
    rig = view.rig._replace(weight=np.where(view.rig.weight > 0.0, direct, 0.0))
    intensities = (
        STRETCH_INTENSITIES if view.die.corner_radius_m * scale_px_per_m(view, frames) > 2.0 * SHARP_PX else 0.0
    )

    def one(k: int) -> tuple[float, Array, Array]:
        equations, motion = new_equations(), frames.motion[k]
        start = PoseState(frames.position_m[k], frames.rotation[k], motion[:3], motion[3:])
        p, R, _ = refine_and_score(
            whole_frame_windows(view, frames.pictures[k]), view.model(settings, rig), start,
            weak_prior(view, start.position), 0, new_workspace(view.shape, view.rig), equations,
        )  # fmt: skip
        cost, pixels, stretches, log_noise = equations.statistics[[ROBUST_COST, PIXELS, STRETCHES, LOG_NOISE]]
        if not (pixels > 0.0 and equations.H[0, 0] > 0.0):
            return np.nan, frames.position_m[k], frames.rotation[k]
        return float((BIWEIGHT_CUT**2 / 6.0 * cost + log_noise + intensities * stretches) / pixels), p, R

    with ThreadPoolExecutor(THREADS) as pool:
        misfit, position, rotation = zip(*pool.map(one, range(len(frames))), strict=True)
    return np.array(misfit), replace(frames, position_m=np.array(position), rotation=np.array(rotation))


def winsorised_mean(values: Array) -> tuple[float, float]:
    """Mean of the finite values, clipped at WINSOR_SIGMAS, and its standard error; (0, infinite) for fewer than
    FEWEST_FRAMES."""
    values = values[np.isfinite(values)]
    if len(values) < FEWEST_FRAMES:
        return 0.0, np.inf
    median = np.median(values)
    cut = WINSOR_SIGMAS * NORMAL_MAD * np.median(np.abs(values - median))
    values = np.clip(values, median - cut, median + cut)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def _far_shoulder(radii: Array, gains: Array) -> float:
    """The largest radius at which the gain, linear between the radii, is SHOULDER of its maximum; 0 if no radius
    gains."""
    wanted = SHOULDER * gains.max()
    if not wanted > 0.0:
        return 0.0
    last = int(np.flatnonzero(gains >= wanted)[-1])
    if last == len(radii) - 1:
        return float(radii[last])
    share = (gains[last] - wanted) / (gains[last] - gains[last + 1])
    return float(radii[last] + share * (radii[last + 1] - radii[last]))


def _minimum(radii: Array, misfits: Array) -> float:
    """The radius of the smallest mean misfit (n, radii): the vertex of the parabola through the smallest and its
    neighbours; 0 if the first radius, that of a sharp die, has the smallest."""
    mean = misfits.mean(0)
    best = int(np.argmin(mean))
    if best == 0:
        return 0.0
    if best == len(radii) - 1:
        return float(radii[best])
    x, y = radii[best - 1 : best + 2], mean[best - 1 : best + 2]
    a, b, _ = np.polyfit(x / x[1], y, 2)
    return float(np.clip(-b / (2.0 * a) * x[1], x[0], x[2])) if a > 0.0 else float(x[1])


def scale_px_per_m(view: View, frames: SampledFrames) -> float:
    """Pixels per metre at the die, in the median frame."""
    distance = np.linalg.norm(frames.position_m - view.camera.centre_m, axis=1)
    return float(view.camera.matrix[0, 0] / np.median(distance))
