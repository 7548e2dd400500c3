"""The moving die: its body and trails in 3D, its edges in the camera's image, and its heights, spin and energy over time."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.throw import Throw
from ...tracking.camera import Camera
from ..elements import BLACK, COLOURS, WHITE, Colour, Motion, VisibleEdges, mixed, visible_edges
from .timelines import Clock, nanoseconds, on_frames, send_clears, send_instants

Array = NDArray[np.float64]

CURVE_WIDTHS = {"measured": 3.5, "simulated": 1.2}
"""Widths of curves [points]. The model is thinner and on top, so both are visible where they agree."""
SILHOUETTE_RADII = {"measured": 1.8, "simulated": 0.5}
INNER_EDGE_RADII = {"measured": 1.2, "simulated": 0.4}
CORNER_RADII = {"measured": 2.8, "simulated": 1.2}
"""Radii of edges and corners in the camera's image [points], by the same rule."""
DRAW_ORDERS = {"measured": 10.0, "simulated": 20.0}
"""Order of drawing in the camera's image: larger numbers are on top."""


def send_die(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """Send the poses, the body, and the trails and heights of the corners."""
    if len(motion.frame):
        _send_body(recording, solid, motion)
        _send_trail(recording, solid, motion)
        _send_heights(recording, solid, motion)


def _send_body(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """Send the poses, and the body from the first frame of each run of known poses to the first frame without a pose.

    The mesh is not static, because static data cannot be cleared: a lost die would remain at its last position.
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
    """Flat faces, each with its own tint, so that a reader can follow a face through the throw."""
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


def _send_trail(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """The path of every corner since the previous frame; the views show the last TRAIL_FRAMES of these."""
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
    """One curve per corner, interrupted where no pose is known."""
    entity, count = f"plots/height/{motion.name}", len(solid.vertices)
    style = rr.SeriesLines(
        colors=[COLOURS[motion.name]] * count,
        names=[f"{motion.name} corner {k}" for k in range(count)],
        widths=[CURVE_WIDTHS[motion.name]] * count,
    )
    recording.log(entity, style, static=True)
    heights = 1e3 * motion.corners_m(solid)[:, :, 2]
    columns = rr.Scalars.columns(scalars=heights.ravel()).partition(np.full(len(heights), count))
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), columns)
    send_clears(recording, entity, motion)


def send_spin_and_energy(recording: rr.RecordingStream, motion: Motion, throw: Throw, clock: Clock) -> None:
    """Angular speed and energy of each flight as steps: both are constant in flight and jump at a bounce."""
    begins = flight_begins(throw, clock)
    speeds = np.array([np.linalg.norm(flight.start.omega_rad_s) for flight in throw.flights])
    _send_steps(recording, f"plots/spin/{motion.name}", motion.name, begins, speeds, clock)
    if throw.impacts:
        energies = [throw.impacts[0].energy_before_J, *(impact.energy_after_J for impact in throw.impacts)]
        _send_steps(recording, f"plots/energy/{motion.name}", motion.name, begins, 1e3 * np.array(energies), clock)


def flight_begins(throw: Throw, clock: Clock) -> Array:
    """The beginning of each flight [s]; the first flight begins no earlier than the recording."""
    first = max(float(clock.time_s[0]), throw.flights[0].start.time_s)
    times = [impact.time_s for impact in throw.impacts]
    return np.array([min([first, *times]), *times])


def _send_steps(
    recording: rr.RecordingStream, entity: str, name: str, begins_s: Array, values: Array, clock: Clock
) -> None:
    """Values that hold from each instant to the next, the last one to the end; NaN values are left out."""
    known = np.isfinite(values)
    if not known.any():
        return
    instants = np.append(begins_s[known], max(clock.time_s[-1], begins_s[-1]))
    style = rr.SeriesLines(
        colors=COLOURS[name],
        names=name,
        widths=CURVE_WIDTHS[name],
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )
    recording.log(entity, style, static=True)
    steps = np.append(values[known], values[known][-1])
    send_instants(recording, entity, instants, clock, rr.Scalars.columns(scalars=steps))


# --- in the camera's image ---


def send_visible_edges(recording: rr.RecordingStream, solid: Solid, camera: Camera, motion: Motion) -> None:
    """Silhouette, inner edges and corners in the camera's image, with lens distortion."""
    poses = visible_edges(solid, camera, motion.position_m, motion.quaternion)
    if not poses:
        return
    image, name = "world/camera/image", motion.name
    silhouettes = [edges.silhouette_px for edges in poses]
    inner = [edges.inner_px for edges in poses]
    _send_lines(recording, f"{image}/silhouette/{name}", motion, silhouettes, SILHOUETTE_RADII[name])
    _send_lines(recording, f"{image}/edges/{name}", motion, inner, INNER_EDGE_RADII[name])
    _send_corners(recording, f"{image}/corners/{name}", motion, poses)


def _send_lines(
    recording: rr.RecordingStream, entity: str, motion: Motion, lines_px: list[Array], radius: float
) -> None:
    style = rr.LineStrips2D.from_fields(
        colors=[COLOURS[motion.name]], radii=[-radius], draw_order=DRAW_ORDERS[motion.name]
    )
    recording.log(entity, style, static=True)
    counts = [len(lines) for lines in lines_px]
    strips = rr.LineStrips2D.columns(strips=_viewer_px(np.concatenate(lines_px))).partition(counts)
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), strips)
    send_clears(recording, entity, motion)


def _send_corners(recording: rr.RecordingStream, entity: str, motion: Motion, poses: list[VisibleEdges]) -> None:
    radius = CORNER_RADII[motion.name]
    style = rr.Points2D.from_fields(colors=[COLOURS[motion.name]], radii=[-radius], draw_order=DRAW_ORDERS[motion.name])
    recording.log(entity, style, static=True)
    corners = [edges.corners_px for edges in poses]
    points = rr.Points2D.columns(positions=_viewer_px(np.concatenate(corners))).partition([len(c) for c in corners])
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), points)
    send_clears(recording, entity, motion)


def _viewer_px(points_px: Array) -> Array:
    """The origin of the viewer is the corner of the first pixel, that of the camera model its centre."""
    return points_px + 0.5
