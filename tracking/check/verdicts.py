"""Judges the quality of a clip: a verdict (good, doubtful or bad) in every respect, what was measured, and what to change.

The limits and their reasons:

- pixels: the error of a pose in pixels hardly depends on the die's size, so the error of its rotation goes with one over the
  size. A cube of 50 px gives single poses good to some tenths of a degree, one of 25 px to a degree;
- motion blur: the edge model includes it. Above 1 px it flattens an edge more than the lens does. Above 6 px (a full-frame
  exposure at 2 mm a frame) neighbouring edges run into each other;
- corners: an estimate of their radius is off by a sixth of it, a caliper by less;
- shutter: a readout that is left out shears the die and bends its flights; it is reported where it is certain, at five standard
  errors, and a tenth of the frame interval at least;
- lens blur: below 0.3 px edges alias; above 1.5 px the lens is out of focus;
- scale and vertical: calibrated cameras and measured edges reach one per cent and half a degree. A value is doubtful where the
  measurement cannot distinguish it from a good one;
- table: bounces happen at z = 0. A calibration to one thousandth leaves a depth error of half a millimetre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ..clip_parameters import CornerRounding
from ..footage import AS_STORED, MOSAIC, REPEATED, TURNED
from ..timing import FaultKind, FrameTimes
from ..track import LOST
from .clip_quality import BackgroundMatch, ClipQuality, FrameTiming, TrackedPart
from .gravity import Fall, fall_notices
from .second_die import SecondDie
from .shutter import Readout

Array = NDArray[np.float64]


class Verdict(Enum):
    """How good a clip is in one respect."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """The verdict on a clip in one respect."""

    name: str
    verdict: Verdict
    measured: str
    """What was measured, as a sentence."""
    advice: str = ""
    """What to change; empty where nothing needs to."""
    values: Mapping[str, float | None] = field(default_factory=dict)
    """The numbers, with the unit in each name."""


GOOD_SIZE_PX = 50.0
"""Smallest size of the die with rotations good to some tenths of a degree."""
MIN_SIZE_PX = 25.0
"""Smallest size of the die with rotations good to a degree."""
SMALL_MOTION_BLUR_PX = 1.0
"""Largest motion blur that flattens an edge less than the lens does."""
MAX_MOTION_BLUR_PX = 6.0
"""Largest motion blur at which neighbouring edges stay apart."""
ALIASING_BLUR_PX = 0.3
"""Largest lens blur at which edges alias."""
SOFT_BLUR_PX = 1.5
"""Largest lens blur of a focused lens."""
MAX_LENS_BLUR_PX = 2.5
"""Largest lens blur with which a clip is worth tracking."""
MAX_SHIFT_PX = 25.0
"""Shift of a corner between frames; with a larger one the next pose is hardly predicted."""
SOME_SATURATION = 0.002
"""Share of the die's pixels at full scale that the robust estimate bears."""
MAX_SATURATION = 0.05
"""Share of the die's pixels at full scale with which whole edges are lost."""
MIN_BRIGHTNESS = 0.15
"""Brightest level as a share of full scale, below which rounding and read noise cost precision."""
SMALL_DIFFERENCE = 0.02
"""Share of the pixels that nearly always differ from the background; more of them are of a lamp that moved."""
MAX_DIFFERENCE = 0.15
"""The same; more of them are of a camera that moved."""
OFFSET_SIGMAS = 2.0
"""Largest good difference in light between clip and background, in standard deviations of the noise."""
OFFSET_GREY = 2.0
"""The same in grey levels, where the noise is smaller."""
GOOD_SCALE = 0.01
"""Share of g, and so of the edge, that calibrated cameras and measured edges reach."""
MAX_SCALE_ERROR = 0.05
"""Share of g beyond which the scale is wrong."""
GOOD_TILT_RAD = np.radians(0.5)
"""Angle to the vertical that calibrated cameras reach."""
MAX_TILT_RAD = np.radians(2.0)
"""Angle beyond which the vertical is wrong."""
GOOD_HEIGHT_M = 0.5e-3
"""Height of the bounces that a calibration to one thousandth leaves."""
MAX_HEIGHT_M = 2e-3
"""Height of the bounces beyond which the table is wrong."""
TWO_SIDED_95 = 1.96
"""Half width of a 95 % interval, in standard errors."""
CERTAIN = 1.5
"""Half widths of a 95 % interval beyond which a deviation is not chance: three standard errors, one case in three hundred."""
MAX_UNEVEN_SHARE = 0.02
"""Largest good deviation of a step between frames from the median step."""
READOUT_SIGMAS = 5.0
"""Standard errors by which the readout must be off: no global shutter may be called a rolling one."""
LEAST_READOUT_SHARE = 0.1
"""The same as a share of the frame interval: less moves a die by a few hundredths of the frame's own motion."""
OPEN_READOUT_SHARE = 0.5
"""Share of the frame interval up to which a readout would go unnoticed where the pictures are said to show none."""
MAX_EXPOSURE_MISMATCH = 0.1
"""Share by which the exposures of scene and file may differ: headers round it."""
OF_PICTURES = (TURNED, AS_STORED, MOSAIC)
"""Words of the reader's notices that say nothing of the times."""
MAX_LOST_SHARE = 0.1
"""Largest share of lost frames among the tracked and lost ones that is good."""


def judge(
    quality: ClipQuality,
    die: Die,
    exposure_s: float | None,
    rounding: CornerRounding = CornerRounding.GIVEN,
    readout_s: float = 0.0,
) -> tuple[Finding, ...]:
    """Every finding on a clip; `exposure_s` and `readout_s` are the scene's, and `rounding` says whether it gives the radius of
    the corners."""
    findings = [
        _timing(quality.timing, exposure_s),
        *_pictures(quality.timing),
        _background(quality.background_match),
        _light(quality.background_match, quality.tracked_part),
    ]
    tracked_part = quality.tracked_part
    if tracked_part is None:
        advice = "check the clip, the background and [die]; a manual initial pose ([start]) may help"
        return (*findings, Finding("die", Verdict.BAD, f"No die could be tracked: {quality.failure}.", advice))
    findings += [_tracking(tracked_part), _size(tracked_part), _motion_blur(tracked_part), _lens_blur(tracked_part)]
    findings.append(_shutter(tracked_part.readout, readout_s))
    if tracked_part.second_die is not None:
        findings.append(_second_die(tracked_part.second_die))
    if rounding is not CornerRounding.GIVEN:
        findings.append(_corners(tracked_part))
    findings += [
        _scale(tracked_part.fall, die),
        _vertical(tracked_part.fall),
        _table(tracked_part.contact_height_m, tracked_part.contact_sigma_m),
    ]
    return tuple(findings)


def judge_throw(
    timing: FrameTiming, fall: Fall | None, contacts: tuple[Array, Array], die: Die, exposure_s: float | None
) -> tuple[Finding, ...]:
    """Findings on timing and calibration from a finished track; `contacts` are heights (k,) [m] and their sigmas (k,).

    Wrong poses on a few frames change a fall as well, so it is bad only where it is far off (`fall_notices`).
    """
    by_fall = [_scale(fall, die), _vertical(fall)]
    if not fall_notices(fall):
        by_fall = [replace(f, verdict=Verdict.DOUBTFUL) if f.verdict is Verdict.BAD else f for f in by_fall]
    return _timing(timing, exposure_s), *_pictures(timing), *by_fall, _table(*contacts)


def _timing(timing: FrameTiming, exposure_s: float | None) -> Finding:
    values: dict[str, float | None] = {
        "rate_hz": timing.rate_hz,
        "file_rate_hz": timing.file_rate_hz,
        "playback_hz": timing.playback_hz,
        "largest_uneven_share": timing.uneven_share,
    }
    notices = [notice for notice in timing.notices if not any(words in notice for words in OF_PICTURES)]
    repeated = [notice for notice in notices if REPEATED in notice]
    measured = f"{timing.frames} frames at {timing.rate_hz:.6g} frames/s"
    if timing.file_rate_hz is not None:
        measured += ", the rate that the file declares"
    elif timing.playback_hz is not None:
        measured += f" by the scene; the file declares only a playback rate of {timing.playback_hz:g} frames/s"
    else:
        measured += " by the scene; the file declares no rate"
    if timing.found is not None and timing.found.faults:
        return _frame_faults(timing.found, measured, values)
    if repeated:
        advice = "the software filled in dropped frames; export the clip again, or exclude these frames (clip.exclude)"
        return Finding("timing", Verdict.BAD, f"{measured}. {repeated[0]}", advice, values)
    if timing.uneven_share > MAX_UNEVEN_SHARE or notices:
        rest = " ".join(notices) or f"Steps between frames vary by {100 * timing.uneven_share:.2g} %."
        return Finding(
            "timing", Verdict.DOUBTFUL, f"{measured}. {rest}", "check whether these times are the camera's", values
        )
    scene_s, file_s = exposure_s, timing.file_exposure_s
    if scene_s is not None and file_s is not None and abs(scene_s - file_s) > MAX_EXPOSURE_MISMATCH * file_s:
        measured += f"; the exposure is {1e6 * file_s:.4g} µs by the file and {1e6 * scene_s:.4g} µs by the scene"
        return Finding("timing", Verdict.DOUBTFUL, measured + ".", f"set clip.exposure_s = {file_s:.4g}", values)
    return Finding("timing", Verdict.GOOD, f"{measured}, evenly spaced.", "", values)


def _pictures(timing: FrameTiming) -> tuple[Finding, ...]:
    """What the reader changed in the pictures: their orientation, and the mosaic of a colour sensor."""
    turned = [notice for notice in timing.notices if TURNED in notice]
    stored = [notice for notice in timing.notices if AS_STORED in notice]
    mosaics = [notice for notice in timing.notices if MOSAIC in notice]
    advice = "check that [camera] and background show the frames as they are stored"
    sharper = (
        "edges are sharper with a monochrome camera, or in luminance that the camera's software has made of the colours"
    )
    return (
        *(Finding("orientation", Verdict.GOOD, notice) for notice in turned),
        *(Finding("orientation", Verdict.DOUBTFUL, notice, advice) for notice in stored),
        *(Finding("mosaic", Verdict.DOUBTFUL, notice, sharper) for notice in mosaics),
    )


def _frame_faults(found: FrameTimes, measured: str, values: dict[str, float | None]) -> Finding:
    """Missing, doubled and frozen frames: bad where they are certain and the times are left as filmed."""
    for kind in FaultKind:
        values[f"{kind.value}_gaps"] = float(sum(fault.kind is kind for fault in found.faults))
    certain = [fault for fault in found.faults if fault.is_certain]
    text = f"{measured}. {' '.join(found.notices)}"
    if certain and not found.corrected:
        advice = (
            "export the clip again with every frame, or leave --timing as-filmed out so that the times are corrected"
        )
        return Finding("timing", Verdict.BAD, text, advice, values)
    advice = (
        "export the clip again with every frame"
        if certain
        else "look at these frames, or leave them out (clip.exclude)"
    )
    return Finding("timing", Verdict.DOUBTFUL, text, advice, values)


def _background(match: BackgroundMatch) -> Finding:
    values = {
        "noise_grey": match.noise_grey,
        "offset_grey": match.offset_grey,
        "differing_share": match.differing_share,
    }
    whose = "The background, estimated from the clip," if match.estimated else "The background"
    measured = (
        f"{whose} differs from nearly every frame on {100 * match.differing_share:.2g} % of the pixels, and by "
        f"{match.offset_grey:+.2g} grey levels in the median; the noise is {match.noise_grey:.2g} grey levels."
    )
    if match.differing_share > MAX_DIFFERENCE:
        advice = "the camera or something in view has moved: take the background again, or leave it out"
        return Finding("background", Verdict.BAD, measured, advice, values)
    if match.differing_share > SMALL_DIFFERENCE or abs(match.offset_grey) > max(
        OFFSET_SIGMAS * match.noise_grey, OFFSET_GREY
    ):
        advice = "the light or the camera may have changed: take the background just before or after the throw"
        return Finding("background", Verdict.DOUBTFUL, measured, advice, values)
    return Finding("background", Verdict.GOOD, measured, "", values)


def _light(match: BackgroundMatch, tracked_part: TrackedPart | None) -> Finding:
    share = tracked_part.saturated_share if tracked_part is not None else None
    values = {"saturated_share": share, "brightest_share": match.brightest_share}
    measured = f"The brightest pixels reach {100 * match.brightest_share:.3g} % of full scale"
    measured += (
        "." if share is None else f"; on the worst frame {100 * share:.2g} % of those around the die are saturated."
    )
    if share is not None and share > SOME_SATURATION:
        verdict = Verdict.BAD if share > MAX_SATURATION else Verdict.DOUBTFUL
        return Finding(
            "light",
            verdict,
            measured,
            "shorten the exposure, close the aperture, or move the lamp that makes the glare",
            values,
        )
    if match.brightest_share < MIN_BRIGHTNESS:
        return Finding(
            "light", Verdict.DOUBTFUL, measured, "use more light: most levels of the sensor are unused", values
        )
    return Finding("light", Verdict.GOOD, measured, "", values)


def _tracking(tracked_part: TrackedPart) -> Finding:
    track = tracked_part.track
    known, lost = int(track.tracked.sum()), int((track.status == LOST).sum())
    bounces = len(tracked_part.throw.impacts) if tracked_part.throw is not None else 0
    measured = f"Of {len(track)} frames, {known} were tracked and {lost} were lost; {bounces} bounces were found."
    values = {"tracked": float(known), "lost": float(lost), "bounces": float(bounces)}
    if known < lost:
        return Finding("die", Verdict.BAD, measured, "check [die], the background, and what hides the die", values)
    if lost > MAX_LOST_SHARE * (known + lost):
        return Finding("die", Verdict.DOUBTFUL, measured, "check what hides the die on the lost frames", values)
    return Finding("die", Verdict.GOOD, measured, "", values)


def _size(tracked_part: TrackedPart) -> Finding:
    low, high = tracked_part.diameter_px
    measured = f"The die has a size of {low:.0f} to {high:.0f} px."
    values = {"least_across_px": low, "most_across_px": high}
    if low < MIN_SIZE_PX:
        return Finding(
            "pixels", Verdict.BAD, measured, "move the camera nearer, or use a longer lens or more pixels", values
        )
    if low < GOOD_SIZE_PX:
        advice = "rotations will be known to tenths of a degree at best; move the camera nearer, or use a longer lens"
        return Finding("pixels", Verdict.DOUBTFUL, measured, advice, values)
    return Finding("pixels", Verdict.GOOD, measured, "", values)


def _motion_blur(tracked_part: TrackedPart) -> Finding:
    values = {"shift_px": tracked_part.shift_px}
    if tracked_part.motion_blur_px is None:
        measured = f"The fastest corner moves {tracked_part.shift_px:.2g} px a frame; its blur needs the exposure."
        return Finding("motion blur", Verdict.DOUBTFUL, measured, "give clip.exposure_s", values)
    usual, most = tracked_part.motion_blur_px
    values |= {"median_px": usual, "p95_px": most}
    measured = (
        f"The motion blur of the fastest corner is {usual:.2g} px in the median and {most:.2g} px at the most (95 %)"
    )
    measured += f"; it moves {tracked_part.shift_px:.2g} px a frame."
    if most > MAX_MOTION_BLUR_PX:
        return Finding("motion blur", Verdict.BAD, measured, "shorten the exposure and use more light", values)
    if tracked_part.shift_px > MAX_SHIFT_PX:
        return Finding(
            "motion blur",
            Verdict.DOUBTFUL,
            measured,
            "record more frames a second: the die moves far from one to the next",
            values,
        )
    if most > SMALL_MOTION_BLUR_PX:
        advice = (
            f"it is modelled but costs precision; {SMALL_MOTION_BLUR_PX / most:.2g} times the exposure would leave 1 px"
        )
        return Finding("motion blur", Verdict.DOUBTFUL, measured, advice, values)
    return Finding("motion blur", Verdict.GOOD, measured, "", values)


def _lens_blur(tracked_part: TrackedPart) -> Finding:
    blur = tracked_part.lens_blur_px
    measured = f"The lens spreads an edge with a standard deviation of {blur:.2g} px."
    values = {"lens_blur_px": blur}
    if blur > MAX_LENS_BLUR_PX:
        return Finding("sharpness", Verdict.BAD, measured, "focus on the die, or close the aperture", values)
    if blur > SOFT_BLUR_PX:
        return Finding("sharpness", Verdict.DOUBTFUL, measured, "focus on the die, or close the aperture", values)
    if blur <= ALIASING_BLUR_PX:
        advice = "edges this sharp alias; a slight defocus makes them more exact"
        return Finding("sharpness", Verdict.DOUBTFUL, measured, advice, values)
    return Finding("sharpness", Verdict.GOOD, measured, "", values)


def _shutter(found: Readout | None, stated_s: float) -> Finding:
    """The readout of a rolling shutter against the scene's, which is 0 for a global one."""
    if found is None:
        measured = "Too few frames in flight show whether the rows are exposed at once."
        return Finding("shutter", Verdict.GOOD, measured, "", {})
    values: dict[str, float | None] = {
        "readout_s": found.readout_s,
        "sigma_readout_s": found.sigma_s,
        "stated_readout_s": stated_s,
    }
    size = f"{1e3 * found.readout_s:.2g} ± {1e3 * found.sigma_s:.2g} ms"
    least_s = max(READOUT_SIGMAS * found.sigma_s, LEAST_READOUT_SHARE * found.interval_s)
    if abs(found.readout_s - stated_s) <= least_s:
        clear = READOUT_SIGMAS * found.sigma_s <= OPEN_READOUT_SHARE * found.interval_s
        says = f"{1e3 * stated_s:.3g} ms by the scene" if stated_s else "a global shutter by the scene"
        known = "consistent with" if clear else "which decides little; it is"
        text = f"From the first row to the last, the shear of the die shows {size} (standard error), {known} {says}."
        return Finding("shutter", Verdict.GOOD, text, "", values)
    if found.readout_s < -least_s:
        text = f"The rows are exposed one after the other from the bottom up: the shear of the die shows {size}."
        advice = "turn clip, background and [camera] upside down, and set clip.readout_s"
        return Finding("shutter", Verdict.BAD, text, advice, values)
    if stated_s == 0.0:
        text = (
            f"The rows are exposed one after the other: the shear of the die shows {size} from the first to the last."
        )
        return Finding("shutter", Verdict.BAD, text, f"set clip.readout_s = {found.readout_s:.2g}", values)
    text = f"The shear of the die shows {size} from the first row to the last; the scene says {1e3 * stated_s:.3g} ms."
    shown = f"the pictures suggest {found.readout_s:.2g}" if found.readout_s > least_s else "the pictures show none"
    advice = f"measure clip.readout_s, or leave it out for a global shutter; {shown}"
    return Finding("shutter", Verdict.DOUBTFUL, text, advice, values)


def _second_die(found: SecondDie) -> Finding:
    """A second die in view; it is there only if one was found."""
    values: dict[str, float | None] = {"frames": float(found.frames), "searched": float(found.searched)}
    measured, _, advice = found.notice.rstrip(".").partition(": ")
    return Finding("second die", Verdict.DOUBTFUL, f"{measured}.", advice, values)


def _corners(tracked_part: TrackedPart) -> Finding:
    found = tracked_part.corners
    if found is None or found.radius_m == 0.0:
        return Finding(
            "corners", Verdict.GOOD, "The pictures show sharp corners, or nearly so.", "", {"corner_radius_m": 0.0}
        )
    radius, sigma = found.radius_m, found.sigma_m
    shown = "The impacts are those of" if found.by_impacts else "The pictures show"
    measured = f"{shown} rounded corners, with a radius of {1e3 * radius:.2f} ± {1e3 * sigma:.2f} mm (standard error)."
    advice = f"measure it and set die.corner_radius_m, or set {radius:.2g}; without it tracking estimates it again"
    values: dict[str, float | None] = {"corner_radius_m": radius, "sigma_corner_radius_m": sigma}
    return Finding("corners", Verdict.DOUBTFUL, measured, advice, values)


NO_FALL = "No flight was long enough to measure the fall."
LONGER = "record more of the fall before the first bounce"


def _scale(fall: Fall | None, die: Die) -> Finding:
    """The size of the acceleration, in terms of the edge: with an edge k times the true one the die falls with k g."""
    if fall is None:
        return Finding("scale", Verdict.DOUBTFUL, NO_FALL, LONGER)
    size = float(np.linalg.norm(fall.acceleration_m_s2))
    along = fall.acceleration_m_s2 / size
    wide = TWO_SIDED_95 * float(np.sqrt(along @ fall.covariance @ along))
    edge, share = die.solid.edge_m, fall.gravity_m_s2 / size
    found, half = edge * share, edge * share * wide / size
    which = "edge" if list(die.solid.dimensions) == ["edge_m"] else "mean edge"
    values: dict[str, float | None] = {
        "acceleration_m_s2": size,
        "acceleration_half_width_m_s2": wide,
        "edge_from_fall_m": found,
        "edge_from_fall_half_width_m": half,
    }
    measured = (
        f"The die falls with {size:.4g} ± {wide:.2g} m/s² (95 %), and gravity is {fall.gravity_m_s2:g}: its {which} would be "
        f"{1e3 * found:.4g} ± {1e3 * half:.2g} mm, the scene says {1e3 * edge:.4g} mm."
    )
    off, doubt = abs(share - 1.0), wide / size
    if off <= max(GOOD_SCALE, doubt) and doubt <= MAX_SCALE_ERROR:
        return Finding("scale", Verdict.GOOD, measured, "", values)
    if off <= CERTAIN * doubt and doubt > GOOD_SCALE:
        return Finding("scale", Verdict.DOUBTFUL, measured, f"the fall is too short to decide; {LONGER}", values)
    advice = (
        f"multiply the lengths of [die] by {share:.4g} or clip.fps by {np.sqrt(share):.4g} if one of them is wrong; else "
        "calibrate again: [camera] may have another focal length than this clip"
    )
    return Finding("scale", Verdict.BAD if off > MAX_SCALE_ERROR else Verdict.DOUBTFUL, measured, advice, values)


def _vertical(fall: Fall | None) -> Finding:
    """The direction of the acceleration."""
    if fall is None:
        return Finding("vertical", Verdict.DOUBTFUL, NO_FALL, LONGER)
    a = fall.acceleration_m_s2
    tilt = float(np.arctan2(np.linalg.norm(a[:2]), -a[2]))
    aside = a[:2] / max(float(np.linalg.norm(a[:2])), 1e-12)
    wide = TWO_SIDED_95 * float(np.sqrt(aside @ fall.covariance[:2, :2] @ aside)) / fall.gravity_m_s2
    measured = f"The die falls at {np.degrees(tilt):.2g} ± {np.degrees(wide):.2g}° (95 %) to the vertical of [camera]."
    values: dict[str, float | None] = {"tilt_rad": tilt, "tilt_half_width_rad": wide}
    if tilt <= max(GOOD_TILT_RAD, wide) and wide <= MAX_TILT_RAD:
        return Finding("vertical", Verdict.GOOD, measured, "", values)
    if tilt <= CERTAIN * wide and wide > GOOD_TILT_RAD:
        return Finding("vertical", Verdict.DOUBTFUL, measured, f"the fall is too short to decide; {LONGER}", values)
    advice = "calibrate again with the board flat on the table, and check that the table is level"
    return Finding("vertical", Verdict.BAD if tilt > MAX_TILT_RAD else Verdict.DOUBTFUL, measured, advice, values)


def _table(contact_height_m: Array, contact_sigma_m: Array) -> Finding:
    """The height of the contacts."""
    if not len(contact_height_m):
        measured = "No bounce was resolved on these frames, so the height of the table was not measured."
        return Finding("table", Verdict.DOUBTFUL, measured, "check a bounce in the replay of the whole clip")
    middle = float(np.median(contact_height_m))
    # Errors of depth are common to all contacts, so their mean is no better than one of them.
    wide = TWO_SIDED_95 * float(np.median(contact_sigma_m))
    measured = (
        f"The die bounces at z = {1e3 * middle:+.2g} ± {1e3 * wide:.2g} mm (95 %, {len(contact_height_m)} bounces)."
    )
    values: dict[str, float | None] = {"contact_m": middle, "contact_half_width_m": wide}
    if abs(middle) <= max(GOOD_HEIGHT_M, wide):
        return Finding("table", Verdict.GOOD, measured, "", values)
    advice = "correct translation_m of [camera], by the thickness of the board perhaps, or lengths and corner_radius_m of [die]"
    return Finding(
        "table",
        Verdict.BAD if abs(middle) > max(MAX_HEIGHT_M, CERTAIN * wide) else Verdict.DOUBTFUL,
        measured,
        advice,
        values,
    )
