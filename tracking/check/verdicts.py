"""What `preflight` measured, judged: good, doubtful or bad, in words, with what to change.

The limits, and what they rest on:

- pixels across: the error of a pose in pixels hardly depends on the die's size, so that its rotation goes with one over the
  size; at 50 px a cube's single pose is good to some tenths of a degree, at 25 px to a degree;
- motion blur: the edge model includes it; above 1 px the step of an edge is flatter than the lens makes it, above 6 px
  (a full-frame exposure at 2 mm a frame) neighbouring edges run into each other;
- corners: an estimate of their radius is off by a sixth of it, which a caliper is not;
- lens blur: below 0.3 px edges alias, above 1.5 px a focus was missed;
- gravity and direction: calibrated cameras and measured edges come to a per cent and half a degree; a doubtful value is one
  that the measurement cannot tell from a good one either;
- table: bounces happen at z = 0; half a millimetre is what a depth error of a calibration to a thousandth leaves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.world import GRAVITY_M_S2
from ..clip_parameters import CornerRounding
from .clip_quality import Backdrop, Preflight, Sight, Timing
from .gravity import Fall, fall_notices

Array = NDArray[np.float64]


class Verdict(Enum):
    """How good a clip is in one respect."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """One respect in which a clip was looked at."""

    name: str
    verdict: Verdict
    measured: str
    """A sentence."""
    advice: str = ""
    """What to change; empty where nothing is to be."""
    values: Mapping[str, float | None] = field(default_factory=dict)
    """The numbers, with the unit in each name."""


ENOUGH_PX, FEWEST_PX = 50.0, 25.0
LITTLE_MOTION_PX, MOST_MOTION_PX = 1.0, 6.0
SHARP_PX, SOFT_PX, UNSHARP_PX = 0.3, 1.5, 2.5
FAR_STEP_PX = 25.0
"""Shift of a corner between frames: further, the next pose is guessed rather than predicted."""
SOME_GLARE, MUCH_GLARE = 0.002, 0.05
"""Share of the die's pixels at full scale."""
DARK = 0.15
"""Brightest level as a share of full scale, below which rounding and read noise cost precision."""
CLEAN_BACKDROP, FOREIGN_BACKDROP = 0.02, 0.15
"""Share of pixels that differ from the background nearly always: some are of a lamp that moved, many of a camera that did."""
OFFSET_SIGMAS, OFFSET_GREY = 2.0, 2.0
"""By how much the light of the clip may differ from that of the background."""
EXACT_SHARE, FAIR_SHARE = 0.01, 0.05
"""Of g, and so of the edge."""
LEVEL_RAD, TILTED_RAD = np.radians(0.5), np.radians(2.0)
AT_TABLE_M, NEAR_TABLE_M = 0.5e-3, 2e-3
TWO_SIDED_95 = 1.96
CERTAIN = 1.5
"""Times the half width of a 95 % interval beyond which chance is no excuse: three sigmas, one case in three hundred."""
UNEVEN_STEPS = 0.02
"""Deviation of a step between frames from the usual one."""


def judge(
    seen: Preflight, die: Die, exposure_s: float | None, rounding: CornerRounding = CornerRounding.GIVEN
) -> tuple[Finding, ...]:
    """Every finding about a clip; `exposure_s` is the scene's, and `rounding` whether it gives the corners' radius."""
    findings = [_timing(seen.timing, exposure_s), _background(seen.backdrop), _light(seen.backdrop, seen.sight)]
    sight = seen.sight
    if sight is None:
        advice = "look at the clip, the background and [die]; a [start] by hand may help"
        return (*findings, Finding("die", Verdict.BAD, f"No die could be followed: {seen.trouble}.", advice))
    findings += [_followed(sight), _size(sight), _motion_blur(sight), _lens_blur(sight)]
    if rounding is not CornerRounding.GIVEN:
        findings.append(_corners(sight))
    findings += [_scale(sight.fall, die), _vertical(sight.fall), _table(sight.contact_m, sight.contact_sigma_m)]
    return tuple(findings)


def judge_throw(
    timing: Timing, fall: Fall | None, contacts: tuple[Array, Array], die: Die, exposure_s: float | None
) -> tuple[Finding, ...]:
    """What a finished track tells of timing and calibration; `contacts` are heights (k,) [m] and their sigmas (k,).

    Wrong poses on a few frames bend a fall, too: it is called bad only where it is so by far (`fall_notices`).
    """
    by_fall = [_scale(fall, die), _vertical(fall)]
    if not fall_notices(fall):
        by_fall = [replace(f, verdict=Verdict.DOUBTFUL) if f.verdict is Verdict.BAD else f for f in by_fall]
    return _timing(timing, exposure_s), *by_fall, _table(*contacts)


def _timing(timing: Timing, exposure_s: float | None) -> Finding:
    values = {
        "rate_hz": timing.rate_hz,
        "file_rate_hz": timing.file_rate_hz,
        "playback_hz": timing.playback_hz,
        "largest_uneven_share": timing.uneven_share,
    }
    copies = [told for told in timing.notices if "exact copies" in told]
    told = f"{timing.frames} frames at {timing.rate_hz:.6g} frames/s"
    if timing.file_rate_hz is not None:
        told += ", the rate that the file carries"
    elif timing.playback_hz is not None:
        told += f" by the scene; the file itself only says to play {timing.playback_hz:g} a second"
    else:
        told += " by the scene; the file carries no rate"
    if copies:
        advice = "frames were dropped and filled in; export the clip again, or leave them out by clip.exclude"
        return Finding("timing", Verdict.BAD, f"{told}. {copies[0]}", advice, values)
    if timing.uneven_share > UNEVEN_STEPS or timing.notices:
        rest = " ".join(timing.notices) or f"Steps between frames vary by {100 * timing.uneven_share:.2g} %."
        return Finding(
            "timing", Verdict.DOUBTFUL, f"{told}. {rest}", "look whether these times are the camera's", values
        )
    mine, theirs = exposure_s, timing.file_exposure_s
    if mine is not None and theirs is not None and abs(mine - theirs) > 0.1 * theirs:
        told += f"; the exposure is {1e6 * theirs:.4g} µs by the file and {1e6 * mine:.4g} µs by the scene"
        return Finding("timing", Verdict.DOUBTFUL, told + ".", f"set clip.exposure_s = {theirs:.4g}", values)
    return Finding("timing", Verdict.GOOD, f"{told}, evenly spaced.", "", values)


def _background(drop: Backdrop) -> Finding:
    values = {
        "noise_grey": drop.noise_grey,
        "offset_grey": drop.offset_grey,
        "differing_share": drop.differing_share,
    }
    whose = "The background, estimated from the clip," if drop.estimated else "The background"
    told = (
        f"{whose} differs from the clip on {100 * drop.differing_share:.2g} % of the pixels, on nearly every frame, and by "
        f"{drop.offset_grey:+.2g} grey levels in the median; noise {drop.noise_grey:.2g} grey levels."
    )
    if drop.differing_share > FOREIGN_BACKDROP:
        advice = "the camera or something in view has moved since: take the background again, or leave it out"
        return Finding("background", Verdict.BAD, told, advice, values)
    if drop.differing_share > CLEAN_BACKDROP or abs(drop.offset_grey) > max(
        OFFSET_SIGMAS * drop.noise_grey, OFFSET_GREY
    ):
        advice = "the light or the camera may have changed; take the background right before or after the throw"
        return Finding("background", Verdict.DOUBTFUL, told, advice, values)
    return Finding("background", Verdict.GOOD, told, "", values)


def _light(drop: Backdrop, sight: Sight | None) -> Finding:
    share = sight.saturated_share if sight is not None else None
    values = {"saturated_share": share, "brightest_share": drop.brightest_share}
    told = f"The brightest pixels reach {100 * drop.brightest_share:.3g} % of full scale"
    told += "." if share is None else f"; at full scale are {100 * share:.2g} % of those round the die, at the worst."
    if share is not None and share > SOME_GLARE:
        verdict = Verdict.BAD if share > MUCH_GLARE else Verdict.DOUBTFUL
        return Finding(
            "light", verdict, told, "expose shorter, close the aperture, or move the lamp that glares", values
        )
    if drop.brightest_share < DARK:
        return Finding("light", Verdict.DOUBTFUL, told, "more light: the levels of the sensor are hardly used", values)
    return Finding("light", Verdict.GOOD, told, "", values)


def _followed(sight: Sight) -> Finding:
    track = sight.track
    known, lost = int(track.tracked.sum()), int((track.status == "lost").sum())
    bounces = len(sight.throw.impacts) if sight.throw is not None else 0
    told = f"Of {len(track)} frames that were tried, {known} show the pose and {lost} were lost; {bounces} bounces."
    values = {"tracked": float(known), "lost": float(lost), "bounces": float(bounces)}
    if known < lost:
        return Finding("die", Verdict.BAD, told, "look at [die], the background, and what hides the die", values)
    if known < 9 * lost:
        return Finding("die", Verdict.DOUBTFUL, told, "look what hides the die on the frames that were lost", values)
    return Finding("die", Verdict.GOOD, told, "", values)


def _size(sight: Sight) -> Finding:
    low, high = sight.across_px
    told = f"The die is {low:.0f} to {high:.0f} px across."
    values = {"least_across_px": low, "most_across_px": high}
    if low < FEWEST_PX:
        return Finding("pixels", Verdict.BAD, told, "go nearer, or use a longer lens or more pixels", values)
    if low < ENOUGH_PX:
        advice = "rotations will be known to tenths of a degree at best; go nearer, or use a longer lens"
        return Finding("pixels", Verdict.DOUBTFUL, told, advice, values)
    return Finding("pixels", Verdict.GOOD, told, "", values)


def _motion_blur(sight: Sight) -> Finding:
    values = {"shift_px": sight.shift_px}
    if sight.motion_blur_px is None:
        told = (
            f"The fastest corner moves {sight.shift_px:.2g} px a frame; how much of it is blur the scene does not say."
        )
        return Finding("motion blur", Verdict.DOUBTFUL, told, "give clip.exposure_s", values)
    usual, most = sight.motion_blur_px
    values |= {"median_px": usual, "p95_px": most}
    told = f"The fastest corner is blurred over {usual:.2g} px in the median and {most:.2g} px at the most (95 %)"
    told += f", and moves {sight.shift_px:.2g} px a frame."
    if most > MOST_MOTION_PX:
        return Finding("motion blur", Verdict.BAD, told, "expose shorter, with more light", values)
    if sight.shift_px > FAR_STEP_PX:
        return Finding(
            "motion blur", Verdict.DOUBTFUL, told, "more frames a second: the die moves far between two", values
        )
    if most > LITTLE_MOTION_PX:
        advice = (
            f"it is modelled, yet costs precision; {LITTLE_MOTION_PX / most:.2g} times the exposure would leave 1 px"
        )
        return Finding("motion blur", Verdict.DOUBTFUL, told, advice, values)
    return Finding("motion blur", Verdict.GOOD, told, "", values)


def _lens_blur(sight: Sight) -> Finding:
    blur = sight.lens_blur_px
    told = f"The lens spreads an edge with a standard deviation of {blur:.2g} px."
    values = {"lens_blur_px": blur}
    if blur > UNSHARP_PX:
        return Finding("sharpness", Verdict.BAD, told, "focus on the die, or close the aperture", values)
    if blur > SOFT_PX:
        return Finding("sharpness", Verdict.DOUBTFUL, told, "focus on the die, or close the aperture", values)
    if blur <= SHARP_PX:
        advice = "edges alias at this; a trace of defocus makes them more exact"
        return Finding("sharpness", Verdict.DOUBTFUL, told, advice, values)
    return Finding("sharpness", Verdict.GOOD, told, "", values)


def _corners(sight: Sight) -> Finding:
    found = sight.corners
    if found is None or found.radius_m == 0.0:
        return Finding("corners", Verdict.GOOD, "The corners look sharp, or nearly so.", "", {"corner_radius_m": 0.0})
    radius, sigma = found.radius_m, found.sigma_m
    told = f"The corners look rounded, with a radius of {1e3 * radius:.2f} ± {1e3 * sigma:.2f} mm (standard error)."
    advice = (
        f"measure it and write it as die.corner_radius_m, or write {radius:.2g}; left out, tracking estimates it again"
    )
    values: dict[str, float | None] = {"corner_radius_m": radius, "sigma_corner_radius_m": sigma}
    return Finding("corners", Verdict.DOUBTFUL, told, advice, values)


NO_FALL = "No flight was long enough to measure the fall."
LONGER = "let the clip show more of the fall before the first bounce"


def _scale(fall: Fall | None, die: Die) -> Finding:
    """The size of the acceleration, as an edge: with an edge k times the true one the die falls with k g."""
    if fall is None:
        return Finding("scale", Verdict.DOUBTFUL, NO_FALL, LONGER)
    size = float(np.linalg.norm(fall.acceleration_m_s2))
    along = fall.acceleration_m_s2 / size
    wide = TWO_SIDED_95 * float(np.sqrt(along @ fall.covariance @ along))
    edge, share = die.solid.edge_m, GRAVITY_M_S2 / size
    found, half = edge * share, edge * share * wide / size
    values: dict[str, float | None] = {
        "acceleration_m_s2": size,
        "acceleration_half_width_m_s2": wide,
        "edge_from_fall_m": found,
        "edge_from_fall_half_width_m": half,
    }
    told = (
        f"The die falls with {size:.4g} ± {wide:.2g} m/s² (95 %), where gravity is {GRAVITY_M_S2:g}: its edge would be "
        f"{1e3 * found:.4g} ± {1e3 * half:.2g} mm, the scene says {1e3 * edge:.4g} mm."
    )
    off, doubt = abs(share - 1.0), wide / size
    if off <= max(EXACT_SHARE, doubt) and doubt <= FAIR_SHARE:
        return Finding("scale", Verdict.GOOD, told, "", values)
    if off <= CERTAIN * doubt and doubt > EXACT_SHARE:
        return Finding("scale", Verdict.DOUBTFUL, told, f"the fall is too short to tell; {LONGER}", values)
    advice = (
        f"die.edge_m {share:.4g} times, or clip.fps {np.sqrt(share):.4g} times what the scene says would put it right; "
        "or the focal length of [camera] is not that of this clip"
    )
    return Finding("scale", Verdict.BAD if off > FAIR_SHARE else Verdict.DOUBTFUL, told, advice, values)


def _vertical(fall: Fall | None) -> Finding:
    """The direction of the acceleration."""
    if fall is None:
        return Finding("vertical", Verdict.DOUBTFUL, NO_FALL, LONGER)
    a = fall.acceleration_m_s2
    tilt = float(np.arctan2(np.linalg.norm(a[:2]), -a[2]))
    aside = a[:2] / max(float(np.linalg.norm(a[:2])), 1e-12)
    wide = TWO_SIDED_95 * float(np.sqrt(aside @ fall.covariance[:2, :2] @ aside)) / GRAVITY_M_S2
    told = f"The die falls {np.degrees(tilt):.2g} ± {np.degrees(wide):.2g}° (95 %) off the vertical of [camera]."
    values: dict[str, float | None] = {"tilt_rad": tilt, "tilt_half_width_rad": wide}
    if tilt <= max(LEVEL_RAD, wide) and wide <= TILTED_RAD:
        return Finding("vertical", Verdict.GOOD, told, "", values)
    if tilt <= CERTAIN * wide and wide > LEVEL_RAD:
        return Finding("vertical", Verdict.DOUBTFUL, told, f"the fall is too short to tell; {LONGER}", values)
    advice = "calibrate again with the board flat on the table, and look whether the table is level"
    return Finding("vertical", Verdict.BAD if tilt > TILTED_RAD else Verdict.DOUBTFUL, told, advice, values)


def _table(contact_m: Array, contact_sigma_m: Array) -> Finding:
    """The height of the contacts."""
    if not len(contact_m):
        told = "No bounce was resolved on the frames at hand, so the table's height was not measured."
        return Finding("table", Verdict.DOUBTFUL, told, "look at a bounce in the replay of the whole clip")
    middle = float(np.median(contact_m))
    # Errors of depth are common to all contacts, so their mean is no better than one of them.
    wide = TWO_SIDED_95 * float(np.median(contact_sigma_m))
    told = f"The die bounces at z = {1e3 * middle:+.2g} ± {1e3 * wide:.2g} mm (95 %, {len(contact_m)} bounces)."
    values: dict[str, float | None] = {"contact_m": middle, "contact_half_width_m": wide}
    if abs(middle) <= max(AT_TABLE_M, wide):
        return Finding("table", Verdict.GOOD, told, "", values)
    advice = (
        "translation_m of [camera] puts the table elsewhere, by the board's thickness perhaps; or die.edge_m or "
        "corner_radius_m is wrong"
    )
    return Finding(
        "table",
        Verdict.BAD if abs(middle) > max(NEAR_TABLE_M, CERTAIN * wide) else Verdict.DOUBTFUL,
        told,
        advice,
        values,
    )
