"""One recording for one throw: experiment and model on the same two timelines, `frame` and `t` (see `clock`).

    world                                 metres, z up
      table                               the plane z = 0 with a grid of 10 mm
      camera                              pose and pinhole of the camera
        image                             the film
          silhouette, edges, corners      /measured and /simulated, projected through the lens
      measured, simulated
        die                               the pose, with its mesh and edges
        trail                             where every corner has just been
        impacts, impulses                 contact points on the table, and how hard it struck
    plots                                 height, spin, energy, residual, chi, odds
    events, phase                         bounces and what each told; flights, and what tracking knows
    report/estimate                       the findings in words

`scenery` sends what stands still, `dice` what moves, `strikes` the bounces, `overlay` what is drawn on the film, and
`comparison` what lies between experiment and model.
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
from .dice import send_die, send_spin_and_energy
from .impacts import arrow_scale, send_bounce_chi, send_bounces
from .overlay import send_overlay
from .scenery import SceneBounds, scene_bounds_of, send_footage, send_table
from .timelines import Clock

if TYPE_CHECKING:
    from ...fitting.predict import Estimate
    from ...fitting.results import Parameter

Array = NDArray[np.float64]

APPLICATION = "diethrow"
"""Recordings of one application make one data set: the viewer lists them in one table, with their properties."""


def write_recording(path: Path, record: Record) -> None:
    """Write the throw as a Rerun recording with its views, to be opened by `diethrow replay` or `rerun PATH`.

    What the record lacks (clip, camera, fit, poses of some frames) is absent from the recording, and no pose stands
    on a frame where it is not known. Raises OSError where the file cannot be written.
    """
    motions = motions_of(record)
    clock = Clock(record.track.frame, record.track.time_s)
    stage = scene_bounds_of(record.die.solid, motions, record.camera)
    rest = residuals(record.track, record.simulated) if record.simulated is not None else None
    estimates = record.estimates
    picture_px = (record.clip.width_px, record.clip.height_px) if record.clip is not None else None
    shown = _shown(record.die, stage, motions, record.fps, picture_px=picture_px, rest=rest, estimates=estimates)
    with open_recording(path, record.title, _identity(record.title, motions), blueprint(shown)) as recording:
        _send_properties(recording, record)
        send_table(recording, stage.low_m, stage.high_m)
        display = send_footage(recording, record)
        scale = arrow_scale(record.die.solid, motions)
        for motion in motions:
            _send_motion(recording, record.die, motion, clock, scale, stage)
            if record.camera is not None:
                send_overlay(recording, record.die.solid, record.camera, motion)
        send_status(recording, record.track)
        if rest is not None:
            send_residuals(recording, rest)
        send_bounce_chi(recording, motions[0], clock)
        send_estimates(recording, estimates, clock)
        _send_text(recording, markdown(record, display))


def write_throw_recording(path: Path, die: Die, throw: Throw, fps: float, title: str) -> None:
    """Write a modelled throw alone, with poses on the frames of a camera at `fps` [Hz].

    Raises ValueError where fps is not positive, and OSError where the file cannot be written.
    """
    track = track_of(throw, fps)
    motion = motion_of("simulated", track, throw)
    clock = Clock(track.frame, track.time_s)
    stage = scene_bounds_of(die.solid, [motion], None)
    shown = _shown(die, stage, [motion], fps)
    with open_recording(path, title, _identity(title, [motion]), blueprint(shown)) as recording:
        recording.send_property("throw", rr.AnyValues(bounces=len(throw.bounces), frames=len(track), fps_hz=fps))
        send_table(recording, stage.low_m, stage.high_m)
        _send_motion(recording, die, motion, clock, arrow_scale(die.solid, [motion]), stage)
        send_bounce_chi(recording, motion, clock)
        lines = [f"- {bounce_sentence(k, impact)}" for k, impact in enumerate(throw.bounces, 1)]
        _send_text(recording, "\n".join([f"# {title}", "", *(lines or ["No bounce."])]))


@contextmanager
def open_recording(path: Path, title: str, identity: str, views: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream into `path` that raises on bad calls instead of warning, and leaves no torso behind.

    `identity` is the recording's id: two recordings that share it are one for the viewer.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent} is not a folder: make it before the recording {path.name} is written")
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
    """The title, and a mark of the poses: other models of one throw stay apart, and the same throw keeps its id."""
    poses = hashlib.sha256()
    for motion in motions:
        for values in (motion.time_s, motion.position_m, motion.quaternion):
            poses.update(np.ascontiguousarray(values).tobytes())
    return f"{title}-{poses.hexdigest()[:8]}"


def _shown(
    die: Die,
    stage: SceneBounds,
    motions: Sequence[Motion],
    fps: float,
    *,
    picture_px: tuple[int, int] | None = None,
    rest: Residuals | None = None,
    estimates: Sequence[Estimate] = (),
) -> RecordingContents:
    """What the views are made for."""
    impacts = motions[0].impacts
    return RecordingContents(
        motions=tuple(motion.name for motion in motions),
        fps=fps,
        eye_m=stage.eye_m,
        target_m=stage.target_m,
        frames=stage.frames,
        height_mm=1e3 * float(stage.high_m[2]),
        radius_m=die.solid.circumradius,
        picture_px=picture_px,
        residuals=rest if rest is not None and len(rest.frame) else None,
        chi_range=_chi_range(impacts, estimates),
        odds=any(estimate.face_odds for estimate in estimates),
        bounces=any(motion.impacts for motion in motions),
    )


def _chi_range(impacts: Sequence[Impact], estimates: Sequence[Estimate]) -> tuple[float, float] | None:
    """What the plot of χ has to show; None where no χ is known."""
    values = [chi for i in impacts for chi in (i.chi, i.chi_low, i.chi_high)]
    values += [chi for e in estimates for chi in (e.chi.value, e.chi.low, e.chi.high) if chi is not None]
    known = np.array(values, float)
    known = known[np.isfinite(known)]
    if not len(known):
        return None
    margin = max(0.1 * float(np.ptp(known)), 1e-3)
    return float(max(known.min() - margin, 0.0)), float(min(known.max() + margin, 1.0 + margin))


def _send_motion(
    recording: rr.RecordingStream, die: Die, motion: Motion, clock: Clock, scale: float, stage: SceneBounds
) -> None:
    send_die(recording, die.solid, motion)
    if motion.throw is not None:
        send_spin_and_energy(recording, motion, motion.throw, clock)
        send_bounces(recording, motion, motion.throw, clock, scale, 1e3 * float(stage.high_m[2]))


def _send_properties(recording: rr.RecordingStream, record: Record) -> None:
    """What a table of many throws says of this one."""
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
    """The fitted restitution where the fit determined one."""
    chi = record.fit.parameters.get("chi") if record.fit is not None else None
    return chi if chi is not None and chi.value is not None else None


def _send_text(recording: rr.RecordingStream, text: str) -> None:
    recording.log("report/estimate", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
