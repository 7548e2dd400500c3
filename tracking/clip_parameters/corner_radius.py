"""How rounded the die is, where nobody has measured it: the radius with which the pictures are explained best.

A die with corners of radius r is drawn for several r, and what the edge model then leaves over is compared, frame by
frame, as the negative logarithm of its likelihood a pixel,

    ℓ(r) = (TUKEY²/6 Σ ρ + Σ ln s + 2 K)/n,

the biweight's cost ρ in units of a Gaussian's, the noise s of every stretch of edge, and the two more intensities
that each stretch of a rounded edge has (Akaike's price of K numbers). Per pixel, because a rounded edge is broader
and has more of them. Three questions are asked, each of some frames spread over the clip:

1. **Is the die rounded at all?** The pose of each frame is free. A contour that is a radius r away from the sharp
   corner's lies up to 0.4 r further in, which a larger distance imitates; strips of their own shade between the
   faces, and contours that are one or the other from face to face, a distance does not. `is_rounded` says yes where ℓ
   falls by more than any sharp die's and more than chance.
2. **About how much?** ℓ over radii of growing size with poses as free (`radius_by_free_poses`). Glancing light draws
   the contour in by a tenth of a pixel, the poses go along, and the least ℓ lies at a radius too small, by up to two
   thirds. Its far shoulder is nearer to the truth, and good for a first model, with which the flights become what
   they are.
3. **How much?** In flight the die falls with g and bounces on z = 0, which tells its distance. The least ℓ with the
   poses where the flights have the die, none free (`radius_on_flights`).

A radius that is off leaves a contour error that is alike on all frames, and the flights can correct for it where its
prior is wide enough: `contour_sigma_px`, which goes with the track. Sharp dice pay for the first question alone.
Sharp and rounded are compared by one and the same equations, on the same ends of the edges: sharp is a radius of
SHARP_PX.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..picture import (
    BIWEIGHT_CUT,
    PARAMETERS,
    THREADS,
    RefinementSettings,
    View,
    new_workspace,
    rounded,
    shares_in_view,
    whole_frame_windows,
)
from ..pose import Picture, SampledFrames, refine_and_score
from ..throw import flights_only, outline_growth
from ..track import Track

Array = NDArray[np.float64]

RADIUS_FRAMES, MORE_FRAMES = 24, 72
"""Frames that are asked: their mean is five times as sure as what one says; and where that leaves the first question
open."""
SHARP_PX = 0.02
"""Radius of a die drawn sharp by the very equations of a rounded one, on the same pixels: strips of this width show
nothing."""
NOTICED_PX, NOTICED_BLUR_PX = 1.0, 0.7
"""Radius that is tried against none: what this blur still shows. A wider one shows as much more: at 2.4 px of blur a
tetrahedron that is sharp is explained better by the strips of one pixel, for what the blur of its corners does to the
edges beside them."""
ROUND_TESTED_PX, PLAIN_FRAMES = 4.0, 8
"""The same of a die so round that so little changes nothing, which fewer frames show already; wider with the blur as
well."""
GAIN, SURE = 0.02, 2.0
"""Least fall of ℓ for a die to be taken for rounded, and the standard errors by which a fall lies clearly above or
below, and above none. `docs/tracking.md` has the table of what sharp and rounded dice show."""
WINSOR = 3.0
"""Sigmas (by the median deviation) beyond which a frame counts as if it lay there."""
LEAST_PX, RATIO, MOST_SHARE = 0.5, 1.4, 0.6
"""First radius that is tried, each one over the last, and the largest as a share of the inscribed radius."""
WORSE = 0.15
"""By how much ℓ may rise above its least before larger radii are not tried any more."""
SHOULDER = 0.9
"""Share of the greatest gain. With poses free ℓ has a broad and skew bottom, whose least lies at 0.3 to 0.9 times the
true radius: a larger distance makes up for a radius that is too small, and nothing for one that is too large. On
rendered clips this shoulder lies at 0.7 to 1.1 times."""
ASTRAY = 0.3
"""By how much ℓ may be less with the pose of a frame free than on its flight: beyond it the flight is wrong there."""
NEAR_RATIO, NEAR_STEPS = 1.25, 5
"""Radii about a first one that are tried on flights: up to three times as large, and as small."""
FREE_SHARE, FREE_PX = 0.25, 0.3
"""One sigma of a radius by free poses: of the radius, and of any."""
FLIGHT_SHARE, FLIGHT_PX = 0.15, 0.1
"""The same by flights. With the true poses of rendered clips the least lay 0.8 to 1.1 times the true radius: how far
down a bevel an edge looks like one is the light's affair."""
INSET_SHARE = 0.02
"""Least inset of an outline by a radius: a die seen from in front of a face all the time has none."""
NEAR_BOUNCE = 1.5
"""Frames from an impact within which no flight is trusted."""
FEWEST = 6
"""Frames below which nothing is said."""
STEPS, ENOUGH = 6, 0.01
"""Most steps of a free pose, and the gain [squared sigmas] of the last one."""
STRIP_SHARE = 0.5
"""How far strips may differ from their faces where it is asked whether there are any, see `RefinementSettings`: no
picture denies strips of any shade."""


class CornerRounding(StrEnum):
    """What is to be done about the radius of the corners."""

    GIVEN = "given"
    """Nothing: the die has the radius that it says."""
    TESTED = "looked at"
    """The die is sharp unless the pictures plainly show it rounded."""
    ESTIMATED = "estimated"
    """The die is known to be rounded, by how much is to be found."""


@dataclass(frozen=True)
class CornerRadius:
    """How rounded the pictures show the die to be."""

    radius_m: float
    sigma_m: float
    """Standard error, the light on the bevels included."""

    @property
    def notice(self) -> str:
        """One sentence for who reads the result."""
        if self.radius_m == 0.0:
            return f"the corners look sharp: no radius was found, ± {1e3 * self.sigma_m:.2f} mm."
        return (
            f"the corners look rounded, with a radius of {1e3 * self.radius_m:.2f} ± {1e3 * self.sigma_m:.2f} mm, which the "
            "poses take into account; if it is known better, write it as die.corner_radius_m."
        )


# --- the questions ----------------------------------------------------------------------------------------------------


def tested_radius_px(view: View) -> float:
    """Radius [px] that is tried against none at the lens blur of a view."""
    return NOTICED_PX * max(1.0, view.blur_px / NOTICED_BLUR_PX)


def rounding_gain(view: View, looks: SampledFrames, radius_px: float) -> tuple[float, float]:
    """By how much corners of this radius explain the pictures of a view with sharp ones better: mean fall of ℓ over the
    frames, what lies far off brought nearer, and its standard error."""
    if len(looks) < FEWEST:
        return 0.0, np.inf
    px_per_m = scale_px_per_m(view, looks)
    radius = radius_px / px_per_m
    if radius > MOST_SHARE * view.die.solid.inradius:
        return 0.0, np.inf  # so few pixels that a die this rounded would be a ball
    sharp, round_ = (_misfits(rounded(view, r), looks, _free(view))[0] for r in (SHARP_PX / px_per_m, radius))
    return _winsorised(sharp - round_)


def is_rounded(view: View, looks: Callable[[int], SampledFrames]) -> bool:
    """Whether the die of a view with sharp corners is plainly rounded; `looks(count)` are so many frames at the
    most."""
    seen = looks(RADIUS_FRAMES)
    gain, sigma = rounding_gain(view, seen.some(PLAIN_FRAMES), ROUND_TESTED_PX / NOTICED_PX * tested_radius_px(view))
    if gain > max(GAIN, SURE * sigma):
        return True
    gain, sigma = rounding_gain(view, seen, tested_radius_px(view))
    if abs(gain - GAIN) < SURE * sigma < np.inf:
        gain, sigma = rounding_gain(view, looks(MORE_FRAMES), tested_radius_px(view))
    return gain > max(GAIN, SURE * sigma)


def radius_by_free_poses(view: View, looks: SampledFrames) -> CornerRadius | None:
    """The radius at the far shoulder of ℓ with the pose of each frame free: the largest that keeps SHOULDER of what
    the best gains over none. 0 where none gains, None where fewer than FEWEST frames tell."""
    if len(looks) < FEWEST:
        return None
    px_per_m = scale_px_per_m(view, looks)
    most = MOST_SHARE * view.die.solid.inradius
    sharp, here = _misfits(rounded(view, SHARP_PX / px_per_m), looks, _free(view))
    radii, gains = [0.0], [0.0]
    radius = LEAST_PX / px_per_m
    while radius < most and gains[-1] > max(gains) - WORSE:
        # From the poses of the radius before: the die comes nearer as it loses its corners.
        misfit, here = _misfits(rounded(view, radius), here, _free(view))
        radii.append(radius)
        gains.append(_winsorised(sharp - misfit)[0])
        radius *= RATIO
    found = _far_shoulder(np.array(radii), np.array(gains))
    return CornerRadius(found, float(np.hypot(FREE_SHARE * found, FREE_PX / px_per_m)))


def radius_on_flights(view: View, looks: SampledFrames, first_m: float, contour_px: float = 0.0) -> CornerRadius | None:
    """The radius of least ℓ about a first one, with the poses of the looks as they are; 0 where no radius is better
    than none, None where fewer than FEWEST frames tell. `contour_px` is the standard error of the contour that the
    flights leave: of their distance, in pixels of the outline."""
    if len(looks) < FEWEST:
        return None
    px_per_m = scale_px_per_m(view, looks)
    ratios = NEAR_RATIO ** np.arange(-NEAR_STEPS, NEAR_STEPS + 1.0)
    radii = np.append(
        SHARP_PX / px_per_m,
        np.minimum(max(first_m, LEAST_PX / px_per_m) * ratios, MOST_SHARE * view.die.solid.inradius),
    )
    radii = np.unique(radii)
    held, start = _free(view)._replace(fine_steps=1), rounded(view, max(first_m, LEAST_PX / px_per_m))
    apart = _misfits(start, looks, held)[0] - _misfits(start, looks, _free(view))[0]
    levels = np.array([_misfits(rounded(view, r), looks, held)[0] for r in radii]).T
    levels = levels[np.isfinite(levels).all(1) & (apart < ASTRAY)]
    n = len(levels)
    if n < FEWEST:
        return None
    best = _least(radii, levels)
    # The jackknife: what the radius would be without each of the frames.
    without = np.array([_least(radii, np.delete(levels, k, 0)) for k in range(n)])
    scatter = np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum())
    inset = contour_sigma_px(view, 1.0, looks.position_m, looks.rotation)
    errors = (scatter, FLIGHT_SHARE * best, FLIGHT_PX / px_per_m, contour_px / max(inset, INSET_SHARE * px_per_m))
    return CornerRadius(best, float(np.linalg.norm(errors)))


def sample_in_flight(view: View, picture: Picture, track: Track, throw: Throw) -> SampledFrames:
    """Frames of a track that show the whole die on its flights, at the poses of the flights."""
    throw = flights_only(throw)
    spacing_s = float(np.median(np.diff(track.time_s)))
    bounces = np.array([impact.time_s for impact in throw.impacts])
    near = np.abs(track.time_s[:, None] - bounces).min(1, initial=np.inf) < NEAR_BOUNCE * spacing_s
    rows = np.flatnonzero(track.tracked & ~near & (track.time_s <= throw.flights[-1].end_s))
    position, quaternion = throw.poses(track.time_s[rows])
    rotation, motion = matrix_from_quat(quaternion), throw.rates(track.time_s[rows])
    whole = shares_in_view(view, position, rotation) == 1.0
    return SampledFrames.at(rows[whole], picture, position[whole], rotation[whole], motion[whole], RADIUS_FRAMES)


def contour_sigma_px(view: View, radius_sigma_m: float, position_m: Array, rotation: Array) -> float:
    """One sigma [px] of the contour error that a radius of such a sigma leaves on all frames alike, at poses (n, 3),
    (n, 3, 3).

    Of a silhouette of area A and perimeter P about an inscribed radius ρ, corners of radius r take r (2 A/ρ - P) off,
    so that its outline lies r (2 A/(P ρ) - 1) further in on the average.
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


def _free(view: View) -> RefinementSettings:
    """The lens of a refinement whose pose is free, and of strips of any shade: what faces show of the light is no
    matter here."""
    dark = np.zeros_like(view.light)
    return view.settings._replace(fine_steps=STEPS, enough=ENOUGH, samples=0, strip_share=STRIP_SHARE, light=dark)


def _misfits(view: View, looks: SampledFrames, settings: RefinementSettings) -> tuple[Array, SampledFrames]:
    """ℓ of each frame (n,) for the radius of the view's die, NaN where no edge is seen, and the looks at the refined
    poses.

    Mirrors are left out: bevels in them are lit from below, and a reflection takes part in no first pass either.
    """
    direct = (np.arange(len(view.rig.weight)) < len(view.cameras)).astype(float)
    rig = view.rig._replace(weight=np.where(view.rig.weight > 0.0, direct, 0.0))
    intensities = 2.0 if view.die.corner_radius_m * scale_px_per_m(view, looks) > 2.0 * SHARP_PX else 0.0

    def one(k: int) -> tuple[float, Array, Array]:
        H, g, stats = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros(8)
        p, R, _ = refine_and_score(
            whole_frame_windows(view, looks.pictures[k]), view.backgrounds, rig, view.shape, settings, looks.position_m[k],
            looks.rotation[k], looks.motion[k, :3], looks.motion[k, 3:], settings.loose_m, settings.loose_rad, 0,
            new_workspace(view.shape, view.rig), H, g, stats,
        )  # fmt: skip
        cost, pixels, stretches, log_noise = stats[0], stats[2], stats[5], stats[6]
        if not (pixels > 0.0 and H[0, 0] > 0.0):
            return np.nan, looks.position_m[k], looks.rotation[k]
        return float((BIWEIGHT_CUT**2 / 6.0 * cost + log_noise + intensities * stretches) / pixels), p, R

    with ThreadPoolExecutor(THREADS) as pool:
        misfit, position, rotation = zip(*pool.map(one, range(len(looks))), strict=True)
    return np.array(misfit), replace(looks, position_m=np.array(position), rotation=np.array(rotation))


def _winsorised(values: Array) -> tuple[float, float]:
    """Mean of what is finite, with what lies far off brought nearer, and its standard error; (0, infinite) of too
    little."""
    values = values[np.isfinite(values)]
    if len(values) < FEWEST:
        return 0.0, np.inf
    middle = np.median(values)
    wide = WINSOR * 1.4826 * np.median(np.abs(values - middle))
    values = np.clip(values, middle - wide, middle + wide)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def _far_shoulder(radii: Array, gains: Array) -> float:
    """The largest radius at which a gain, straight between the radii, is SHOULDER of its greatest; 0 where that is
    the first."""
    wanted = SHOULDER * gains.max()
    if not wanted > 0.0:
        return 0.0
    last = int(np.flatnonzero(gains >= wanted)[-1])
    if last == len(radii) - 1:
        return float(radii[last])
    share = (gains[last] - wanted) / (gains[last] - gains[last + 1])
    return float(radii[last] + share * (radii[last + 1] - radii[last]))


def _least(radii: Array, levels: Array) -> float:
    """The radius of the least mean of levels (n, radii), the vertex of the parabola through the lowest and its
    neighbours; 0 where the first, of a sharp die, is lowest."""
    mean = levels.mean(0)
    best = int(np.argmin(mean))
    if best == 0:
        return 0.0
    if best == len(radii) - 1:
        return float(radii[best])
    x, y = radii[best - 1 : best + 2], mean[best - 1 : best + 2]
    a, b, _ = np.polyfit(x / x[1], y, 2)
    return float(np.clip(-b / (2.0 * a) * x[1], x[0], x[2])) if a > 0.0 else float(x[1])


def scale_px_per_m(view: View, looks: SampledFrames) -> float:
    """Pixels a metre at the die, in the median frame."""
    distance = np.linalg.norm(looks.position_m - view.camera.centre_m, axis=1)
    return float(view.camera.matrix[0, 0] / np.median(distance))
