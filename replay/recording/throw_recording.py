"""The recording of one throw: experiment and model on the same two timelines, `frame` and `t` (see `timelines`).

    world                                 metres, z up
      table                               the plane z = 0 with a grid of 10 mm
      camera                              pose and pinhole of the camera
        image                             the video
          silhouette, edges, corners      /measured and /simulated, projected with lens distortion
      measured, simulated
        die                               the pose, with mesh and edges
        trail                             the recent path of every corner
        impacts, impulses                 contact points on the table, and the table's impulses
    plots                                 height, spin, energy, residual, chi, odds
    events, phase                         bounces and the estimate after each; flights, and the status of tracking
    report/estimate                       the findings as text

`scenery` sends the static part, `dice` the moving die, `impacts` the bounces, and `comparison` the differences between
experiment and model.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.error_utils import strict_mode

from ...model.die import Die
from ...model.throw import Impact, Throw
from ..elements import (
    Motion,
    Record,
    Residuals,
    VideoEncoding,
    bounce_sentence,
    markdown,
    motion_of,
    motions_of,
    residuals,
    short_verdict,
    track_of,
    verdict,
)
from .blueprint import RecordingContents, blueprint
from .comparison import send_estimates, send_residuals, send_status
from .dice import send_die, send_spin_and_energy, send_visible_edges
from .impacts import arrow_scale, send_bounce_chi, send_bounces
from .scenery import SceneBounds, scene_bounds_of, send_footage, send_table
from .timelines import Clock

if TYPE_CHECKING:
    from ...fitting.predict import Estimate
    from ...fitting.results import Parameter

Array = NDArray[np.float64]

CHI_MARGIN = 0.1
"""Margin of the plot of χ above and below its values, as a share of their range."""
MIN_CHI_MARGIN = 1e-3
"""Smallest such margin in χ, for values that are equal."""
APPLICATION = "diethrow"
"""The viewer lists all recordings of one application in one table, with their properties."""


def write_recording(path: Path, record: Record, encoding: VideoEncoding | None = None) -> None:
    """Write the throw as a Rerun recording with its views. `diethrow replay` and `rerun PATH` open it.

    Parts that the record lacks (clip, camera, fit) are absent from the recording, and frames without a pose show no die.
    `encoding` is the video of the record's clip, if its encoding was begun before.
    Raises OSError if the file cannot be written.
    """
    motions = motions_of(record)
    clock = Clock(record.track.frame, record.track.time_s)
    bounds = scene_bounds_of(record.die.solid, motions, record.camera)
    rest = residuals(record.track, record.simulated) if record.simulated is not None else None
    estimates = record.estimates
    image_px = (record.clip.width_px, record.clip.height_px) if record.clip is not None else None
    contents = _contents(record.die, bounds, motions, record.fps, image_px=image_px, rest=rest, estimates=estimates)
    with open_recording(path, record.title, _identity(record.title, motions), blueprint(contents)) as recording:
        _send_properties(recording, record)
        send_table(recording, bounds.low_m, bounds.high_m)
        display = send_footage(recording, record, encoding)
        scale = arrow_scale(record.die.solid, motions)
        for motion in motions:
            _send_motion(recording, record.die, motion, clock, scale, bounds)
            if record.camera is not None:
                send_visible_edges(recording, record.die.solid, record.camera, motion)
        send_status(recording, record.track)
        if rest is not None:
            send_residuals(recording, rest)
        send_bounce_chi(recording, motions[0], clock)
        send_estimates(recording, estimates, clock)
        _send_text(recording, markdown(record, display))


def write_throw_recording(path: Path, die: Die, throw: Throw, fps: float, title: str) -> None:
    """Write a simulated throw alone, with poses on the frames of a camera at `fps` [Hz].

    Raises ValueError if fps is not positive, and OSError if the file cannot be written.
    """
    track = track_of(throw, fps)
    motion = motion_of("simulated", track, throw)
    clock = Clock(track.frame, track.time_s)
    bounds = scene_bounds_of(die.solid, [motion], None)
    contents = _contents(die, bounds, [motion], fps)
    with open_recording(path, title, _identity(title, [motion]), blueprint(contents)) as recording:
        recording.send_property("throw", rr.AnyValues(bounces=len(throw.bounces), frames=len(track), fps_hz=fps))
        send_table(recording, bounds.low_m, bounds.high_m)
        _send_motion(recording, die, motion, clock, arrow_scale(die.solid, [motion]), bounds)
        send_bounce_chi(recording, motion, clock)
        lines = [f"- {bounce_sentence(k, impact)}" for k, impact in enumerate(throw.bounces, 1)]
        _send_text(recording, "\n".join([f"# {title}", "", *(lines or ["No bounce."])]))


@contextmanager
def open_recording(path: Path, title: str, identity: str, views: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream into `path` that raises on invalid calls instead of warning. If the block fails, the file is removed.

    `identity` is the recording's id: the viewer merges recordings with the same id. Raises FileNotFoundError without the
    folder of `path`.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent} is not a folder; create it before writing the recording {path.name}")
    was_strict = strict_mode()
    rr.set_strict_mode(True)
    recording = rr.RecordingStream(APPLICATION, recording_id=identity)
    try:
        recording.set_log_time_enabled(False)
        recording.save(path, default_blueprint=views)
        recording.send_recording_name(title)
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        yield recording
        recording.flush()
        recording.disconnect()
    except BaseException:
        recording.disconnect()
        path.unlink(missing_ok=True)
        raise
    finally:
        rr.set_strict_mode(was_strict)


def _identity(title: str, motions: Sequence[Motion]) -> str:
    """The title and a checksum of the poses: different models of one throw differ, and the same throw keeps its id."""
    checksum = hashlib.sha256()
    for motion in motions:
        for values in (motion.time_s, motion.position_m, motion.quaternion):
            checksum.update(np.ascontiguousarray(values).tobytes())
    return f"{title}-{checksum.hexdigest()[:8]}"


def _contents(
    die: Die,
    bounds: SceneBounds,
    motions: Sequence[Motion],
    fps: float,
    *,
    image_px: tuple[int, int] | None = None,
    rest: Residuals | None = None,
    estimates: Sequence[Estimate] = (),
) -> RecordingContents:
    """The description from which the views are made."""
    impacts = motions[0].impacts
    return RecordingContents(
        motions=tuple(motion.name for motion in motions),
        fps=fps,
        eye_m=bounds.eye_m,
        target_m=bounds.target_m,
        frames=bounds.frames,
        height_mm=1e3 * float(bounds.high_m[2]),
        radius_m=die.solid.circumradius,
        image_px=image_px,
        residuals=rest if rest is not None and len(rest.frame) else None,
        chi_range=_chi_range(impacts, estimates),
        odds=any(estimate.face_odds for estimate in estimates),
        bounces=any(motion.impacts for motion in motions),
    )


def _chi_range(impacts: Sequence[Impact], estimates: Sequence[Estimate]) -> tuple[float, float] | None:
    """The range of the plot of χ; None if no χ is known."""
    values = [chi for i in impacts for chi in (i.chi, i.chi_low, i.chi_high)]
    values += [chi for e in estimates for chi in (e.chi.value, e.chi.low, e.chi.high) if chi is not None]
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    if not len(known):
        return None
    margin = max(CHI_MARGIN * float(np.ptp(known)), MIN_CHI_MARGIN)
    return float(max(known.min() - margin, 0.0)), float(min(known.max() + margin, 1.0 + margin))


def _send_motion(
    recording: rr.RecordingStream, die: Die, motion: Motion, clock: Clock, scale: float, bounds: SceneBounds
) -> None:
    send_die(recording, die.solid, motion)
    if motion.throw is not None:
        send_spin_and_energy(recording, motion, motion.throw, clock)
        send_bounces(recording, motion, motion.throw, clock, scale, 1e3 * float(bounds.high_m[2]))


def _send_properties(recording: rr.RecordingStream, record: Record) -> None:
    """Send the properties that the viewer's table of throws shows."""
    chi = _fitted_chi(record)
    fit = record.fit
    known = {
        "chi": chi.value if chi is not None else None,
        "chi_low": chi.low if chi is not None else None,
        "chi_high": chi.high if chi is not None else None,
        "bounces": len(record.measured.impacts),
        "bounces_fitted": fit.bounces_fitted if fit is not None else None,
        "residual_rms": fit.residual_rms if fit is not None else None,
        "landed_face": fit.landed_face if fit is not None else None,
        "frames": len(record.track),
        "tracked": int(record.track.tracked.sum()),
        "fps_hz": record.fps,
        "verdict": short_verdict(record),
        "summary": " ".join(verdict(record)),
    }
    recording.send_property(
        "throw", rr.AnyValues(**{name: value for name, value in known.items() if value is not None})
    )


def _fitted_chi(record: Record) -> Parameter | None:
    """The fitted restitution; None if the fit did not determine it."""
    chi = record.fit.parameters.get("chi") if record.fit is not None else None
    return chi if chi is not None and chi.value is not None else None


def _send_text(recording: rr.RecordingStream, text: str) -> None:
    recording.log("report/estimate", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
