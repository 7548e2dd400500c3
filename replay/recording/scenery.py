"""The static part of a recording: the table, the camera with its video, and the viewpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...model.die import Solid
from ...tracking.camera import Camera
from ...tracking.footage import Clip
from ..elements import (
    GRID,
    IMPACT,
    TABLE,
    Motion,
    Record,
    VideoEncoding,
    can_encode_av1,
    display_window,
    encode_av1,
    encode_jpegs,
    shown_rows,
)
from .timelines import on_frames

Array = NDArray[np.float64]

GRID_M = 0.01
"""Spacing of the lines on the table."""
TABLE_MARGIN_M = 0.01
"""Margin of the drawn table around the throw."""
TABLE_Z_M = -5e-5
"""Height of the drawn table: a face that lies on it must stay in front."""
FRUSTUM_DEPTH = 0.1
"""Depth of the camera's frustum as drawn, as a share of the camera's distance from the origin: visible, not in the way."""
EYE_DISTANCE = 0.95
"""Distance of the viewpoint in diagonals of the box: the box then fills the view."""
EYE_DIRECTION = np.array([0.35, -0.85, 0.45])
"""Direction of the viewpoint without a camera: from the front, the right and above."""
EMPTY_HALF_M = 0.05
"""Half the side of the box of a recording without a pose."""


@dataclass(frozen=True, eq=False)
class SceneBounds:
    """The box that contains the throw, and the viewpoint."""

    low_m: Array
    """(3,) lowest corner; on the table."""
    high_m: Array
    """(3,) highest corner."""
    eye_m: Array
    """(3,) viewpoint."""
    frames: tuple[int, int]
    """First and last frame with a pose."""

    @property
    def target_m(self) -> Array:
        """(3,) the middle of the box."""
        return np.asarray(0.5 * (self.low_m + self.high_m))


def scene_bounds_of(solid: Solid, motions: Sequence[Motion], camera: Camera | None) -> SceneBounds:
    """The box of the first motion that has poses: the model may continue far beyond the measurement."""
    bounding = next((motion for motion in motions if len(motion.frame)), None)
    if bounding is None:
        low, high, frames = np.full(3, -EMPTY_HALF_M), np.full(3, EMPTY_HALF_M), (0, 1)
    else:
        corners = bounding.corners_m(solid)
        low, high = corners.min((0, 1)), corners.max((0, 1))
        frames = int(bounding.frame[0]), int(bounding.frame[-1])
    low[2] = 0.0
    return SceneBounds(low, high, eye_of(low, high, camera.centre_m if camera is not None else None), frames)


def eye_of(low_m: Array, high_m: Array, camera_m: Array | None = None) -> Array:
    """(3,) the viewpoint from which a box fills a view, on the side of the camera if there is one."""
    target = 0.5 * (low_m + high_m)
    direction = camera_m - target if camera_m is not None else EYE_DIRECTION
    diagonal_m = float(np.linalg.norm(high_m - low_m))
    return np.asarray(target + direction / np.linalg.norm(direction) * EYE_DISTANCE * diagonal_m)


def send_table(recording: rr.RecordingStream, low_m: Array, high_m: Array) -> None:
    """Send a square around a box, with lines every GRID_M."""
    middle = np.round(0.5 * (low_m + high_m)[:2] / GRID_M) * GRID_M
    half = GRID_M * np.ceil((0.5 * float((high_m - low_m)[:2].max()) + TABLE_MARGIN_M) / GRID_M)
    ticks = np.arange(-half, half + 0.5 * GRID_M, GRID_M)
    corners = [(x, y, TABLE_Z_M) for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]
    plane = np.add(corners, [*middle, 0.0])
    recording.log(
        "world/table/plane",
        rr.Mesh3D(vertex_positions=plane, triangle_indices=[(0, 1, 2), (0, 2, 3)], vertex_colors=[TABLE] * 4),
        static=True,
    )
    across = [[(-half, tick, 0.0), (half, tick, 0.0)] for tick in ticks]
    along = [[(tick, -half, 0.0), (tick, half, 0.0)] for tick in ticks]
    lines = np.add(across + along, [*middle, 0.0])
    recording.log("world/table/grid", rr.LineStrips3D(lines, radii=-0.4, colors=[GRID]), static=True)


def send_footage(
    recording: rr.RecordingStream, record: Record, encoding: VideoEncoding | None = None
) -> tuple[str, ...]:
    """Send the camera and its video, if there are any; returns notices about the images, one sentence each. `encoding` is that of
    the record's clip, if it was begun before."""
    if record.camera is not None:
        _send_camera(recording, record.camera)
    if record.clip is None:
        return ("This recording contains no video.",)
    return _send_video(recording, record.clip, encoding)


def _send_camera(recording: rr.RecordingStream, camera: Camera) -> None:
    recording.log("world/camera", rr.Transform3D(translation=camera.centre_m, mat3x3=camera.rotation.T), static=True)
    recording.log(
        "world/camera",
        rr.Pinhole(
            image_from_camera=np.add(camera.matrix, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]),
            resolution=(camera.width_px, camera.height_px),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=FRUSTUM_DEPTH * float(np.linalg.norm(camera.centre_m)),
            color=IMPACT,
        ),
        static=True,
    )


def _send_video(recording: rr.RecordingStream, clip: Clip, encoding: VideoEncoding | None) -> tuple[str, ...]:
    """Send the clip as AV1, or as JPEG images if this FFmpeg has no AV1 encoder; returns notices."""
    window = display_window(clip)
    entity, rows = "world/camera/image", shown_rows(clip)
    frames, times_s = clip.first_frame + rows, clip.times_s[rows]
    notices = []
    if len(rows) < len(clip):
        notices.append(
            f"The video shows one frame in {rows[1] - rows[0]}, because the clip is long; poses are on every frame."
        )
    if clip.bit_depth > 8:
        levels = f"{window.black:.0f} to {window.white:.0f}"
        notices.append(f"The video shows the grey levels {levels} of {clip.bit_depth} bits as black to white.")
    if can_encode_av1():
        encoded = encode_av1(clip, window) if encoding is None else encoding.result()
        video = rr.AssetVideo(contents=encoded, media_type="video/mp4")
        timestamps_ns = video.read_frame_timestamps_nanos()
        assert len(timestamps_ns) == len(rows), f"{len(timestamps_ns)} frames in the video of {len(rows)}"
        recording.log(entity, video, static=True)
        references = rr.VideoFrameReference.columns_nanos(timestamps_ns)
        recording.send_columns(entity, on_frames(frames, times_s), references)
    else:
        notices.append("The video is stored as JPEG images, because no AV1 encoder was found.")
        for number, jpeg in enumerate(encode_jpegs(clip, window)):
            row = on_frames(frames[number : number + 1], times_s[number : number + 1])
            recording.send_columns(entity, row, rr.EncodedImage.columns(blob=[jpeg], media_type=["image/jpeg"]))
    return tuple(notices)
