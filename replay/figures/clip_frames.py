"""Figures made of frames of the clip: one frame, a multiple exposure of the throw, and strips of frames around bounces.

The multiple exposure follows Fig. 4 of Kapitaniak et al. (Chaos 22, 047504, 2012). The die of each chosen frame is cut out
along its measured silhouette and laid over the empty scene, later frames on top. The empty scene is the median of the same
frames: a place that a die covers on any of them is covered by a cut-out as well, so no die is left in what is seen of it. The
visible edges of each motion are drawn on top, so that differences between experiment and model are visible where they occur.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.errors import InputError
from ...model.throw import Impact
from ..elements import COLOURS, POINTS_PER_EDGE, Motion, VisibleEdges, display_window, hex_colour, visible_edges
from .plot_axes import AnyAxes, PlotAxes

if TYPE_CHECKING:
    from ...tracking.camera import Camera
    from ...tracking.footage import Clip

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

EDGE_WIDTHS = {"measured": 1.8, "simulated": 0.7}
"""Line widths [points]: if both motions agree, the model's line lies within the measured one."""
MAX_EXPOSURES = 24
"""Exposures in one picture: more would hide each other."""
MAX_CANDIDATES = 400
"""Frames that are tried as exposures: two neighbours of a denser selection would always overlap."""
MAX_OVERLAP = 0.45
"""Share of a die that other exposures may cover. Bounces are always shown and may be covered more."""
SAMPLES = 16
"""Points of each straight part of an edge at which it may end behind a later die: one for about two pixels."""
CUT_MARGIN_PX = 1
"""Margin around the silhouette of a cut-out, for the blur of the edges."""

COLUMNS = 7
"""Frames of each bounce side by side; the middle one is nearest to the impact."""
MAX_ROWS = 6
"""Rows of a strip: more do not fit on a page."""
STEP_SHARE = 0.3
"""Share of the die's width that its fastest corner moves from one column to the next."""
GAP = 0.015
"""Half the distance between two images of a strip, as a share of their width."""
CROP_MARGIN = 0.12
"""Margin on each side of all silhouettes in a crop, as a share of their extent."""
LABEL_OFFSET = 0.06
"""Distance of a label from the corner of its image, as a share of its width."""


def stroboscope(ax: AnyAxes, clip: Clip, camera: Camera, solid: Solid, motions: Sequence[Motion]) -> AnyAxes:
    """The whole throw in one picture; the die is cut out at the poses of the first motion.

    Raises ValueError if the first motion has no pose on any frame of the clip.
    """
    rows = _exposures(clip, camera, solid, motions[0])
    window = display_window(clip)
    frames = motions[0].frame[rows].tolist()
    pictures = [window.apply(clip.frame(frame - clip.first_frame)) for frame in frames]
    drawn = visible_edges(solid, camera, motions[0].position_m[rows], motions[0].quaternion[rows])
    picture = _median(pictures)
    cuts = [_cut_out(edges, picture.shape) for edges in drawn]
    for exposure, cut in zip(pictures, cuts, strict=True):
        cv2.copyTo(exposure, cut, picture)
    _show(ax, picture)
    edges = _edges_by_motion(camera, solid, motions, frames)
    lines: dict[str, list[Array]] = {name: [] for name in edges}
    later = np.zeros_like(picture)
    # From the last to the first: a later die also covers the edges of an earlier one.
    for k in range(len(frames) - 1, -1, -1):
        for name in edges:
            lines[name].append(_uncovered(edges[name][k], later))
        later |= cuts[k]
    _draw_edges(ax, lines)
    return _in_pixels(ax, clip)


def _show(ax: PlotAxes, picture: Image, extent: tuple[float, float, float, float] | None = None) -> None:
    ax.imshow(picture, cmap="gray", vmin=0.0, vmax=255.0, interpolation="nearest", extent=extent)


def _in_pixels(ax: AnyAxes, clip: Clip) -> AnyAxes:
    """The axes with the limits of a frame, y downwards."""
    ax.set_xlim(-0.5, clip.width_px - 0.5)
    ax.set_ylim(clip.height_px - 0.5, -0.5)
    ax.set_xlabel("x [px]")
    ax.set_ylabel("y [px]")
    return ax


def bounce_strip(
    ax: AnyAxes, clip: Clip, camera: Camera, solid: Solid, motions: Sequence[Motion], impacts: Sequence[Impact]
) -> AnyAxes:
    """A row of frames for each of the first bounces, with the frame nearest to the impact in the middle.

    Impacts within three frames share a row. All images of a row show the same part of the camera's image, so the table does
    not move between them. A bounce with fewer than two poses around it is left out. Raises ValueError if none is left.
    """
    shown = rows_of_strip(clip, camera, solid, motions[0], impacts)
    if not shown:
        raise InputError("no bounce has two frames with poses around it, so no strip of frames can be drawn")
    corners = [_corner_box(camera, solid, motions[0], [k for k in frames if k is not None]) for _, frames in shown]
    size = (1.0 + 2.0 * CROP_MARGIN) * max(float((high - low).max()) for low, high in corners)
    size = min(size, clip.width_px, clip.height_px)
    window = display_window(clip)
    lines: dict[str, list[Array]] = {motion.name: [] for motion in motions}
    for line, ((row, frames), (low, high)) in enumerate(zip(shown, corners, strict=True)):
        corner = np.clip(0.5 * (low + high - size), -0.5, np.array([clip.width_px, clip.height_px]) - 0.5 - size)
        for column, frame in enumerate(frames):
            if frame is not None:
                crop = Crop(corner, size, np.array([column, line], float))
                _show(ax, *crop.cut(window.apply(clip.frame(frame - clip.first_frame))))
                for name, edges in _edges_by_motion(camera, solid, motions, [frame]).items():
                    lines[name] += [_gapped(crop.of(each)) for each in edges]
                after_ms = 1e3 * float(clip.times_s[frame - clip.first_frame] - impacts[row[0]].time_s)
                _label(ax, f"{after_ms:+.1f}".replace("-", "−"), crop)
    _draw_edges(ax, lines)
    ax.set_xlim(-0.02, COLUMNS + 0.02)
    ax.set_ylim(len(shown) + 0.02, -0.02)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks(np.arange(len(shown)) + 0.5, [_numbers(row) for row, _ in shown])
    ax.tick_params(length=0.0)
    ax.spines[:].set_visible(False)
    ax.set_xlabel("time from the impact, in each picture [ms]")
    ax.set_ylabel("bounce [number]")
    return ax


def edges_on_frame(
    ax: AnyAxes, clip: Clip, camera: Camera, solid: Solid, motions: Sequence[Motion], frame: int
) -> AnyAxes:
    """One frame of the clip with the visible edges of each motion that has a pose there.

    Raises IndexError for a frame that the clip does not have.
    """
    index = frame - clip.first_frame
    if not 0 <= index < len(clip):
        raise IndexError(
            f"frame {frame}: the clip has the frames {clip.first_frame} to {clip.first_frame + len(clip) - 1}"
        )
    _show(ax, display_window(clip).apply(clip.frame(index)))
    edges = _edges_by_motion(camera, solid, motions, [frame])
    _draw_edges(ax, {name: [_gapped(each) for each in of_frame] for name, of_frame in edges.items()})
    return _in_pixels(ax, clip)


def rows_of_strip(
    clip: Clip, camera: Camera, solid: Solid, motion: Motion, impacts: Sequence[Impact]
) -> list[tuple[list[int], list[int | None]]]:
    """The rows of `bounce_strip`: indices of the impacts that share a row, and its frames, None where no pose is known."""
    around = [(row, _frames_around(clip, camera, solid, motion, impacts, row)) for row in _in_rows(clip, impacts)]
    return [(row, frames) for row, frames in around if sum(frame is not None for frame in frames) > 1][:MAX_ROWS]


@dataclass(frozen=True, eq=False)
class Crop:
    """A square part of the camera's image, drawn as a unit square less a gap."""

    corner_px: Array
    """(2,) upper left corner."""
    size_px: float
    cell: Array
    """(2,) column and row in the strip."""

    def of(self, points_px: Array) -> Array:
        """Where points (..., 2) [px] of the camera's image are drawn; NaN for points outside the crop."""
        share = (points_px - self.corner_px) / self.size_px
        inside = ((share >= 0.0) & (share <= 1.0)).all(-1, keepdims=True)
        return np.where(inside, self.cell + GAP + (1.0 - 2.0 * GAP) * share, np.nan)

    def cut(self, picture: Image) -> tuple[Image, tuple[float, float, float, float]]:
        """The whole pixels of an image in the crop, and where they are drawn: left, right, bottom, top."""
        low = np.maximum(np.rint(self.corner_px + 0.5), 0).astype(int)
        high = np.minimum(np.rint(self.corner_px + 0.5 + self.size_px).astype(int), picture.shape[::-1])
        (left, top), (right, bottom) = (
            self.cell + GAP + (1.0 - 2.0 * GAP) * (edge - 0.5 - self.corner_px) / self.size_px for edge in (low, high)
        )
        return picture[low[1] : high[1], low[0] : high[0]], (left, right, bottom, top)


def _label(ax: PlotAxes, text: str, crop: Crop) -> None:
    x, y = crop.cell + LABEL_OFFSET
    box = {"boxstyle": "round,pad=0.15", "fc": "#000000a0", "lw": 0}
    ax.text(float(x), float(y), text, fontsize=7.0, color="#ffffff", va="top", bbox=box)


def _edges_by_motion(
    camera: Camera, solid: Solid, motions: Sequence[Motion], frames: Sequence[int]
) -> dict[str, list[Array]]:
    """For each motion, the visible edges on each frame as polylines (edges, POINTS_PER_EDGE, 2) [px]; none without a pose."""
    found = {}
    for motion in motions:
        known = np.isin(motion.frame, frames)
        drawn = visible_edges(solid, camera, motion.position_m[known], motion.quaternion[known])
        edges = [np.concatenate([visible.silhouette_px, visible.inner_px]) for visible in drawn]
        by_frame = dict(zip(motion.frame[known].tolist(), edges, strict=True))
        found[motion.name] = [by_frame.get(frame, np.empty((0, POINTS_PER_EDGE, 2))) for frame in frames]
    return found


def _gapped(edges: Array) -> Array:
    """Edges (n, points, 2) as one line (n * (points + 1), 2) with NaN after each edge."""
    return np.pad(edges, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 2)


def _uncovered(edges: Array, covered: Image) -> Array:
    """Edges (n, points, 2) [px] as one line (m, 2) that is interrupted by NaN after each edge, and where `covered` is not 0."""
    parts = edges.shape[1] - 1
    place = np.linspace(0.0, parts, SAMPLES * parts + 1)
    before = np.minimum(place.astype(int), parts - 1)
    share = (place - before)[:, None]
    fine = (1.0 - share) * edges[:, before] + share * edges[:, before + 1]
    column, row = np.moveaxis(np.rint(np.clip(fine, -1.0, max(covered.shape))).astype(int), -1, 0)
    inside = (column >= 0) & (row >= 0) & (column < covered.shape[1]) & (row < covered.shape[0])
    hidden = np.zeros(inside.shape, bool)
    hidden[inside] = covered[row[inside], column[inside]] > 0
    # A straight part needs its ends only, and the places where it disappears.
    wanted = hidden | (np.arange(len(place)) % SAMPLES == 0)
    wanted[:, 1:] |= hidden[:, :-1]
    wanted[:, :-1] |= hidden[:, 1:]
    line = _gapped(np.where(hidden[..., None], np.nan, fine))
    return line[np.pad(wanted, ((0, 0), (0, 1)), constant_values=True).ravel()]


def _draw_edges(ax: PlotAxes, lines: Mapping[str, Sequence[Array]]) -> None:
    """The edges of each motion as one curve of lines (points, 2) that NaN ends."""
    for name, parts in lines.items():
        x, y = np.concatenate([np.empty((0, 2)), *parts]).T
        ax.plot(x, y, "-", color=hex_colour(COLOURS[name]), linewidth=EDGE_WIDTHS[name], zorder=2.0)


def _cut_out(edges: VisibleEdges, shape: tuple[int, ...]) -> Image:
    """(height, width): 255 where the die is cut out of its frame."""
    return np.asarray(
        cv2.dilate(_silhouette_mask(edges, shape), np.ones((2 * CUT_MARGIN_PX + 1,) * 2, np.uint8)), np.uint8
    )


def _exposures(clip: Clip, camera: Camera, solid: Solid, motion: Motion) -> NDArray[np.int64]:
    """Rows of the motion to show: bounces, first and last pose, and those between that overlap no more than MAX_OVERLAP."""
    in_clip = np.flatnonzero((motion.frame >= clip.first_frame) & (motion.frame < clip.first_frame + len(clip)))
    if not len(in_clip):
        raise InputError("no frame of the clip has a pose, so no die can be cut out")
    times = motion.time_s[in_clip]
    wanted = {int(in_clip[np.abs(times - impact.time_s).argmin()]) for impact in motion.impacts}
    wanted = set(sorted(wanted)[: MAX_EXPOSURES // 2]) | {int(in_clip[0]), int(in_clip[-1])}
    shape = (clip.height_px, clip.width_px)
    step = max(1, len(in_clip) // MAX_CANDIDATES)
    rows = sorted({*in_clip[::step].tolist(), *wanted})
    drawn = visible_edges(solid, camera, motion.position_m[rows], motion.quaternion[rows])
    covered = np.zeros(shape, np.uint8)
    for row in wanted:
        covered |= _silhouette_mask(drawn[rows.index(row)], shape)
    for row, edges in zip(rows, drawn, strict=True):
        if len(wanted) < MAX_EXPOSURES and row not in wanted:
            mask = _silhouette_mask(edges, shape)
            area = cv2.countNonZero(mask)
            if area and cv2.countNonZero(mask & covered) <= MAX_OVERLAP * area:
                wanted.add(row)
                covered |= mask
    return np.array(sorted(wanted), np.int64)


def _in_rows(clip: Clip, impacts: Sequence[Impact]) -> list[list[int]]:
    """Indices of the impacts, grouped if they would show the same frames."""
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
    """The frames of one row, evenly spaced about its first impact; None for a frame without a pose.

    The spacing keeps them, if possible, within the known poses and clear of the impacts of other rows.
    """
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
    """Frames in which the fastest corner moves by STEP_SHARE of the die's width in the image."""
    drawn = camera.project(motion.corners_m(solid)[rows]) if len(rows) else np.empty((0, 0, 2))
    moved = np.linalg.norm(np.diff(drawn, axis=0), axis=2).max(1) / np.diff(motion.frame[rows])
    fastest = float(np.median(moved)) if len(moved) else 0.0
    width = float(np.ptp(drawn[0], axis=0).max())
    return round(STEP_SHARE * width / fastest) if fastest > 0.0 else 1


def _corner_box(camera: Camera, solid: Solid, motion: Motion, frames: Sequence[int]) -> tuple[Array, Array]:
    """The box that contains the die on these frames: upper left (2,) and lower right (2,) corner [px]."""
    rows = np.flatnonzero(np.isin(motion.frame, frames))
    drawn = visible_edges(solid, camera, motion.position_m[rows], motion.quaternion[rows])
    points = np.concatenate([edges.corners_px for edges in drawn])
    return points.min(0), points.max(0)


def _silhouette_mask(edges: VisibleEdges, shape: tuple[int, ...]) -> Image:
    """(height, width): 255 within the silhouette, 0 outside."""
    mask = np.zeros(shape[:2], np.uint8)
    points = np.concatenate([edges.silhouette_px.reshape(-1, 2), edges.corners_px])
    if len(points) >= 3:
        hull = cv2.convexHull(np.clip(np.rint(points), -1e6, 1e6).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 255)
    return mask


def _median(frames: Sequence[Image]) -> Image:
    """The median of pictures, by odd-even transposition: whole pictures are compared at a time, ten times as fast as NumPy."""
    stack = [frame.copy() for frame in frames]
    for turn in range(len(stack)):
        for k in range(turn % 2, len(stack) - 1, 2):
            stack[k], stack[k + 1] = cv2.min(stack[k], stack[k + 1]), cv2.max(stack[k], stack[k + 1])
    return cv2.addWeighted(stack[(len(stack) - 1) // 2], 0.5, stack[len(stack) // 2], 0.5, 0.0)
