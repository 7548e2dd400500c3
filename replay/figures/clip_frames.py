"""Many exposures in one picture, from the frames of the clip: Fig. 4 of Kapitaniak et al. (Chaos 22, 047504, 2012).

The die of each chosen frame is cut out along its measured outline and laid over the empty scene, later ones on top. The
empty scene is the median of frames over the clip: a die that moves is in few of them at any one place. Edges in view are
drawn as each motion has them, so that what parts experiment from model can be seen where it happens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.throw import Impact
from ...tracking.camera import Camera
from ...tracking.footage import Clip
from ..elements import COLOURS, Motion, VisibleEdges, Window, display_window, hex_colour, visible_edges

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

WIDTHS = {"measured": 1.8, "simulated": 0.7}
"""Of the edges [points]: where both motions agree the model's line lies within the measured one."""
MOST_EXPOSURES = 24
FARTHEST_OVERLAP = 0.45
"""Share of a die that an earlier exposure may hide it by; at bounces, which are always shown, it may be more."""
SCENE_FRAMES = 25
"""Frames whose median is the empty scene: a die must stand at one place in half of them to be seen in it."""
CUT_MARGIN_PX = 1
"""Around the outline, for the blur of the edges."""

COLUMNS = 7
"""Frames of each bounce side by side; the middle one is nearest to the impact."""
MOST_ROWS = 6
STEP_SHARE = 0.3
"""Of the die's width, that it moves between two columns."""
GAP = 0.015
"""Between two pictures of a strip, half of it, as a share of their width."""
CROP_MARGIN = 0.12
"""Of the crop's width, on each side of all outlines in it."""


def stroboscope(ax: Axes, clip: Clip, camera: Camera, solid: Solid, motions: Sequence[Motion]) -> Axes:
    """The whole throw in one picture; the first of `motions` says where the die is cut out.

    Raises ValueError where it knows no pose on any frame of the clip.
    """
    rows = _exposures(clip, camera, solid, motions[0])
    window = display_window(clip)
    scene = _empty_scene(clip, window)
    ax.imshow(scene, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    drawn = visible_edges(solid, camera, motions[0].position_m[rows], motions[0].quaternion[rows])
    for layer, (row, outline) in enumerate(zip(rows, drawn, strict=True), 2):
        frame = int(motions[0].frame[row])
        _lay_over(ax, window.apply(clip.frame(frame - clip.first_frame)), outline, layer)
        # A later die hides the edges of an earlier one, too.
        _draw_edges(ax, camera, solid, motions, frame, layer=layer + 0.5)
    ax.set_xlim(-0.5, clip.width_px - 0.5)
    ax.set_ylim(clip.height_px - 0.5, -0.5)
    ax.set_xlabel("x [px]")
    ax.set_ylabel("y [px]")
    return ax


def bounce_strip(
    ax: Axes, clip: Clip, camera: Camera, solid: Solid, motions: Sequence[Motion], impacts: Sequence[Impact]
) -> Axes:
    """A row of frames for each of the first bounces, the frame nearest to the impact in the middle.

    Impacts within three frames share a row. All pictures of a row show the same piece of the camera's view, so that the
    table stands still in them. A bounce with fewer than two poses around it is left out. Raises ValueError where nothing is left.
    """
    shown = rows_of_strip(clip, camera, solid, motions[0], impacts)
    if not shown:
        raise ValueError("no bounce has two frames of the clip with poses around it, so there is no strip to draw")
    corners = [_corner_box(camera, solid, motions[0], [k for k in frames if k is not None]) for _, frames in shown]
    size = (1.0 + 2.0 * CROP_MARGIN) * max(float((high - low).max()) for low, high in corners)
    size = min(size, clip.width_px, clip.height_px)
    window = display_window(clip)
    for line, ((row, frames), (low, high)) in enumerate(zip(shown, corners, strict=True)):
        corner = np.clip(0.5 * (low + high - size), -0.5, np.array([clip.width_px, clip.height_px]) - 0.5 - size)
        for column, frame in enumerate(frames):
            if frame is not None:
                crop = Crop(corner, size, np.array([column, line], float))
                piece, extent = crop.cut(window.apply(clip.frame(frame - clip.first_frame)))
                ax.imshow(piece, cmap="gray", vmin=0, vmax=255, interpolation="nearest", extent=extent)
                _draw_edges(ax, camera, solid, motions, frame, crop)
                after_ms = 1e3 * float(clip.times_s[frame - clip.first_frame] - impacts[row[0]].time_s)
                _label(ax, f"{after_ms:+.1f}".replace("-", "−"), crop)
    ax.set_xlim(-0.02, COLUMNS + 0.02)
    ax.set_ylim(len(shown) + 0.02, -0.02)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks(np.arange(len(shown)) + 0.5, [_numbers(row) for row, _ in shown])
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    ax.set_xlabel("time from the impact, in each picture [ms]")
    ax.set_ylabel("bounce [number]")
    return ax


def rows_of_strip(
    clip: Clip, camera: Camera, solid: Solid, motion: Motion, impacts: Sequence[Impact]
) -> list[tuple[list[int], list[int | None]]]:
    """The rows of `bounce_strip`: indices of the impacts that share one, and its frames, None where there is no pose."""
    around = [(row, _frames_around(clip, camera, solid, motion, impacts, row)) for row in _in_rows(clip, impacts)]
    return [(row, frames) for row, frames in around if sum(frame is not None for frame in frames) > 1][:MOST_ROWS]


@dataclass(frozen=True, eq=False)
class Crop:
    """A square piece of the camera's picture, drawn as a unit square less a gap."""

    corner_px: Array
    """(2,) upper left."""
    size_px: float
    place: Array
    """(2,) column and row of the square."""

    def of(self, points_px: Array) -> Array:
        """Where points (..., 2) of the camera's picture are drawn; those outside the piece are NaN."""
        share = (points_px - self.corner_px) / self.size_px
        inside = ((share >= 0.0) & (share <= 1.0)).all(-1, keepdims=True)
        return np.where(inside, self.place + GAP + (1.0 - 2.0 * GAP) * share, np.nan)

    def cut(self, picture: Picture) -> tuple[Picture, tuple[float, float, float, float]]:
        """The whole pixels of a picture that the piece holds, and where they are drawn: left, right, bottom, top."""
        low = np.maximum(np.rint(self.corner_px + 0.5), 0).astype(int)
        high = np.minimum(np.rint(self.corner_px + 0.5 + self.size_px).astype(int), picture.shape[::-1])
        (left, top), (right, bottom) = (
            self.place + GAP + (1.0 - 2.0 * GAP) * (edge - 0.5 - self.corner_px) / self.size_px for edge in (low, high)
        )
        return picture[low[1] : high[1], low[0] : high[0]], (left, right, bottom, top)


def _label(ax: Axes, text: str, crop: Crop) -> None:
    x, y = crop.place + 0.06
    ax.text(
        x,
        y,
        text,
        fontsize=7.0,
        color="white",
        va="top",
        bbox={"boxstyle": "round,pad=0.15", "fc": "#000000a0", "lw": 0},
    )


def _draw_edges(
    ax: Axes,
    camera: Camera,
    solid: Solid,
    motions: Sequence[Motion],
    frame: int,
    crop: Crop | None = None,
    layer: float = 2.0,
) -> None:
    """The edges in view on one frame, of every motion that knows its pose there."""
    for motion in motions:
        rows = np.flatnonzero(motion.frame == frame)
        for drawn in visible_edges(solid, camera, motion.position_m[rows], motion.quaternion[rows]):
            edges = np.concatenate([drawn.silhouette_px, drawn.inner_px])
            lines = edges if crop is None else crop.of(edges)
            colour, width = hex_colour(COLOURS[motion.name]), WIDTHS[motion.name]
            drawn_edges = LineCollection(list(lines), colors=colour, linewidths=width, zorder=layer)
            ax.add_collection(drawn_edges, autolim=False)


def _lay_over(ax: Axes, picture: Picture, outline: VisibleEdges, layer: float) -> None:
    """The die of one frame, cut out of its picture."""
    inside = cv2.dilate(_hull(outline, picture.shape), np.ones((2 * CUT_MARGIN_PX + 1,) * 2, np.uint8))
    x, y, width, height = cv2.boundingRect(inside)
    if not width or not height:
        return
    part = np.s_[y : y + height, x : x + width]
    cut = np.dstack([picture[part]] * 3 + [inside[part]])
    extent = (x - 0.5, x + width - 0.5, y + height - 0.5, y - 0.5)
    ax.imshow(cut, interpolation="nearest", extent=extent, zorder=layer)


def _exposures(clip: Clip, camera: Camera, solid: Solid, motion: Motion) -> NDArray[np.int64]:
    """Rows of the motion to be shown: those of the bounces, the ends, and between them whenever the die has moved clear."""
    on_film = np.flatnonzero((motion.frame >= clip.first_frame) & (motion.frame < clip.first_frame + len(clip)))
    if not len(on_film):
        raise ValueError("no frame of the clip has a pose, so there is no die to show")
    times = motion.time_s[on_film]
    wanted = {int(on_film[np.abs(times - impact.time_s).argmin()]) for impact in motion.impacts}
    wanted = set(sorted(wanted)[: MOST_EXPOSURES // 2]) | {int(on_film[0]), int(on_film[-1])}
    shape = (clip.height_px, clip.width_px)
    step = max(1, len(on_film) // 400)  # no two of more exposures would stand apart
    rows = sorted({*on_film[::step].tolist(), *wanted})
    drawn = visible_edges(solid, camera, motion.position_m[rows], motion.quaternion[rows])
    hulls = {row: _hull(outline, shape) > 0 for row, outline in zip(rows, drawn, strict=True)}
    covered = np.zeros(shape, bool)
    for row in wanted:
        covered |= hulls[row]
    for row in rows:
        area = int(hulls[row].sum())
        if len(wanted) < MOST_EXPOSURES and area and (hulls[row] & covered).sum() <= FARTHEST_OVERLAP * area:
            wanted.add(row)
            covered |= hulls[row]
    return np.array(sorted(wanted), np.int64)


def _in_rows(clip: Clip, impacts: Sequence[Impact]) -> list[list[int]]:
    """The impacts by their indices, those together that would show the same frames."""
    frame_s = float(np.median(np.diff(clip.times_s))) if len(clip) > 1 else 0.0
    rows: list[list[int]] = []
    for k, impact in enumerate(impacts):
        if rows and impact.time_s - impacts[rows[-1][0]].time_s < (COLUMNS // 2 + 0.5) * frame_s:
            rows[-1].append(k)
        else:
            rows.append([k])
    return rows


def _numbers(row: Sequence[int]) -> str:
    """The impacts of a row, numbered from 1."""
    return f"{row[0] + 1}" if len(row) == 1 else f"{row[0] + 1} to {row[-1] + 1}"


def _frames_around(
    clip: Clip, camera: Camera, solid: Solid, motion: Motion, impacts: Sequence[Impact], row: Sequence[int]
) -> list[int | None]:
    """The frames of one row, None where there is no pose: evenly spaced about its first impact, and where they can be
    within the poses that are known and clear of the impacts of other rows."""
    time_s = impacts[row[0]].time_s
    middle = int(clip.first_frame + np.abs(clip.times_s - time_s).argmin())
    near = np.flatnonzero(np.abs(motion.frame - middle) <= COLUMNS)
    if not len(near):
        return []
    frame_s = float(np.median(np.diff(clip.times_s))) if len(clip) > 1 else np.inf
    others = [abs(impact.time_s - time_s) / frame_s for k, impact in enumerate(impacts) if k not in row]
    before, after = middle - int(motion.frame[0]), int(motion.frame[-1]) - middle
    reach = COLUMNS // 2
    room = min([*others, *(side for side in (before, after) if side >= reach)], default=reach)
    wanted = _steps_to_move(camera, solid, motion, near)
    step = int(np.clip(wanted, 1, max(1, room // reach)))
    known = set(motion.frame.tolist()) & set(range(clip.first_frame, clip.first_frame + len(clip)))
    frames = (middle + k * step for k in range(-reach, reach + 1))
    return [frame if frame in known else None for frame in frames]


def _steps_to_move(camera: Camera, solid: Solid, motion: Motion, rows: NDArray[np.int64]) -> int:
    """Frames in which the fastest corner moves by STEP_SHARE of the die's width on the picture."""
    drawn = camera.project(motion.corners_m(solid)[rows]) if len(rows) else np.empty((0, 0, 2))
    moved = np.linalg.norm(np.diff(drawn, axis=0), axis=2).max(1) / np.diff(motion.frame[rows])
    fastest = float(np.median(moved)) if len(moved) else 0.0
    width = float(np.ptp(drawn[0], axis=0).max())
    return round(STEP_SHARE * width / fastest) if fastest > 0.0 else 1


def _corner_box(camera: Camera, solid: Solid, motion: Motion, frames: Sequence[int]) -> tuple[Array, Array]:
    """The box (2,), (2,) that holds the die on these frames [px]."""
    rows = np.flatnonzero(np.isin(motion.frame, frames))
    drawn = visible_edges(solid, camera, motion.position_m[rows], motion.quaternion[rows])
    points = np.concatenate([outline.corners_px for outline in drawn])
    return points.min(0), points.max(0)


def _hull(outline: VisibleEdges, shape: tuple[int, ...]) -> Picture:
    """255 (height, width) within the silhouette, 0 outside."""
    mask = np.zeros(shape[:2], np.uint8)
    points = np.concatenate([outline.silhouette_px.reshape(-1, 2), outline.corners_px])
    if len(points) >= 3:
        hull = cv2.convexHull(np.clip(np.rint(points), -1e6, 1e6).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 255)
    return mask


def _empty_scene(clip: Clip, window: Window) -> Picture:
    """The median of frames spread over the clip."""
    chosen = np.unique(np.linspace(0, len(clip) - 1, SCENE_FRAMES).round().astype(int))
    frames = np.stack([window.apply(clip.frame(int(k))) for k in chosen])
    return np.median(frames, axis=0).astype(np.uint8)
