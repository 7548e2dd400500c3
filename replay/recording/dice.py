"""The die in motion: its body in three dimensions, the trails and heights of its corners, its spin and its energy."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.throw import Throw
from ..elements import BLACK, COLOURS, WHITE, Colour, Motion, mixed
from .timelines import Clock, nanoseconds, on_frames, send_instants

Array = NDArray[np.float64]

WIDTHS = {"measured": 3.5, "simulated": 1.2}
"""Of curves. The model is drawn over the measurement, and thinner: both stay in sight where they agree."""


def send_die(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """Poses, the die itself, the trails of its corners and their heights."""
    if len(motion.frame):
        _send_body(recording, solid, motion)
        _send_trail(recording, solid, motion)
        _send_heights(recording, solid, motion)


def _send_body(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """Poses, and the die itself from the first frame of each run of known poses until the first frame without one.

    The mesh is not static: static data cannot be cleared, and a die would stand at its last place while it is lost.
    """
    entity = f"world/{motion.name}/die"
    poses = rr.Transform3D.columns(translation=motion.position_m, quaternion=np.roll(motion.quaternion, -1, axis=1))
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), poses)
    colour = COLOURS[motion.name]
    edges = rr.LineStrips3D(solid.vertices[solid.edges], radii=-0.9, colors=[mixed(colour, WHITE, 0.35)])
    for run in motion.runs:
        begin = slice(run.start, run.start + 1)
        recording.set_time("frame", sequence=int(motion.frame[begin][0]))
        recording.set_time("t", duration=nanoseconds(motion.time_s[begin])[0])
        recording.log(entity, _mesh(solid, colour))
        recording.log(f"{entity}/edges", edges)
    recording.reset_time()
    send_clears(recording, entity, motion)


def _mesh(solid: Solid, colour: Colour) -> rr.Mesh3D:
    """Flat faces, each in its own tint, so that the eye can follow which face is which."""
    positions: list[Array] = []
    normals: list[Array] = []
    tints: list[Colour] = []
    triangles: list[tuple[int, int, int]] = []
    for number, (face, normal) in enumerate(zip(solid.faces, solid.normals, strict=True)):
        first = len(positions)
        positions += [solid.vertices[v] for v in face]
        normals += [normal] * len(face)
        tints += [mixed(colour, WHITE, 0.6 * number / (len(solid.faces) - 1))] * len(face)
        triangles += [(first, first + j, first + j + 1) for j in range(1, len(face) - 1)]
    return rr.Mesh3D(
        vertex_positions=positions, vertex_normals=normals, vertex_colors=tints, triangle_indices=triangles
    )


def send_clears(recording: rr.RecordingStream, entity: str, motion: Motion) -> None:
    """Empty the entity and all below it on every frame without a pose."""
    if len(motion.missing_frame):
        gone = rr.Clear.columns(is_recursive=[True] * len(motion.missing_frame))
        recording.send_columns(entity, on_frames(motion.missing_frame, motion.missing_time_s), gone)


def _send_trail(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """The way of every corner from the frame before; the views join the last of these."""
    corners = motion.corners_m(solid)
    colour = mixed(COLOURS[motion.name], BLACK, 0.25)
    for run in motion.runs:
        steps = np.stack([corners[run][:-1], corners[run][1:]], axis=2)
        if not len(steps):
            continue
        count = np.full(len(steps), len(solid.vertices))
        strips = rr.LineStrips3D.columns(
            strips=steps.reshape(-1, 2, 3), radii=np.full(count.sum(), -0.5), colors=[colour] * int(count.sum())
        ).partition(count)
        rows = slice(run.start + 1, run.stop)
        recording.send_columns(f"world/{motion.name}/trail", on_frames(motion.frame[rows], motion.time_s[rows]), strips)


def _send_heights(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """One curve a corner, broken where the pose is not known."""
    entity, count = f"plots/height/{motion.name}", len(solid.vertices)
    style = rr.SeriesLines(
        colors=[COLOURS[motion.name]] * count,
        names=[f"{motion.name} corner {k}" for k in range(count)],
        widths=[WIDTHS[motion.name]] * count,
    )
    recording.log(entity, style, static=True)
    heights = 1e3 * motion.corners_m(solid)[:, :, 2]
    columns = rr.Scalars.columns(scalars=heights.ravel()).partition(np.full(len(heights), count))
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), columns)
    send_clears(recording, entity, motion)


def send_spin_and_energy(recording: rr.RecordingStream, motion: Motion, throw: Throw, clock: Clock) -> None:
    """Both are constant in flight and jump at a bounce: steps."""
    begins = flight_begins(throw, clock)
    speeds = np.array([np.linalg.norm(flight.start.omega_rad_s) for flight in throw.flights])
    _send_steps(recording, f"plots/spin/{motion.name}", motion.name, begins, speeds, clock)
    if throw.impacts:
        energies = [throw.impacts[0].energy_before_J, *(impact.energy_after_J for impact in throw.impacts)]
        _send_steps(recording, f"plots/energy/{motion.name}", motion.name, begins, 1e3 * np.array(energies), clock)


def flight_begins(throw: Throw, clock: Clock) -> Array:
    """When each flight begins; the first not before the recording does."""
    first = max(float(clock.time_s[0]), throw.flights[0].start.time_s)
    times = [impact.time_s for impact in throw.impacts]
    return np.array([min([first, *times]), *times])


def _send_steps(
    recording: rr.RecordingStream, entity: str, name: str, begins_s: Array, values: Array, clock: Clock
) -> None:
    """Values that hold from each instant to the next, the last one to the end; what is not known is left out."""
    known = np.isfinite(values)
    if not known.any():
        return
    instants = np.append(begins_s[known], max(clock.time_s[-1], begins_s[-1]))
    style = rr.SeriesLines(
        colors=COLOURS[name],
        names=name,
        widths=WIDTHS[name],
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )
    recording.log(entity, style, static=True)
    steps = np.append(values[known], values[known][-1])
    send_instants(recording, entity, instants, clock, rr.Scalars.columns(scalars=steps))
