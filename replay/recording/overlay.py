"""The die drawn on the film: silhouette, edges and corners of each motion, through the lens."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...model.die import Solid
from ...tracking.camera import Camera
from ..elements import COLOURS, Motion, VisibleEdges, visible_edges
from .dice import send_clears
from .timelines import on_frames

Array = NDArray[np.float64]


def send_overlay(recording: rr.RecordingStream, solid: Solid, camera: Camera, motion: Motion) -> None:
    """Visible edges and corners on the film. The simulated die is drawn thinner, and on top."""
    drawn = visible_edges(solid, camera, motion.position_m, motion.quaternion)
    if not drawn:
        return
    top = motion.name == "simulated"
    image, order = "world/camera/image", 20.0 if top else 10.0
    silhouettes = [outline.silhouette_px for outline in drawn]
    inner = [outline.inner_px for outline in drawn]
    _send_lines(recording, f"{image}/silhouette/{motion.name}", motion, silhouettes, 0.5 if top else 1.8, order)
    _send_lines(recording, f"{image}/edges/{motion.name}", motion, inner, 0.4 if top else 1.2, order)
    _send_corners(recording, f"{image}/corners/{motion.name}", motion, drawn, 1.2 if top else 2.8, order)


def _send_lines(
    recording: rr.RecordingStream, entity: str, motion: Motion, lines_px: list[Array], radius: float, order: float
) -> None:
    style = rr.LineStrips2D.from_fields(colors=[COLOURS[motion.name]], radii=[-radius], draw_order=order)
    recording.log(entity, style, static=True)
    counts = [len(lines) for lines in lines_px]
    strips = rr.LineStrips2D.columns(strips=_viewer_px(np.concatenate(lines_px))).partition(counts)
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), strips)
    send_clears(recording, entity, motion)


def _send_corners(
    recording: rr.RecordingStream, entity: str, motion: Motion, drawn: list[VisibleEdges], radius: float, order: float
) -> None:
    style = rr.Points2D.from_fields(colors=[COLOURS[motion.name]], radii=[-radius], draw_order=order)
    recording.log(entity, style, static=True)
    corners = [outline.corners_px for outline in drawn]
    points = rr.Points2D.columns(positions=_viewer_px(np.concatenate(corners))).partition([len(c) for c in corners])
    recording.send_columns(entity, on_frames(motion.frame, motion.time_s), points)
    send_clears(recording, entity, motion)


def _viewer_px(points_px: Array) -> Array:
    """The viewer puts the first pixel's corner at the origin, the camera model its centre."""
    return points_px + 0.5
