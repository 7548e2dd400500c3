"""What stands still in a recording: the table, the camera and its film, and from where all of it is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...model.die import Solid
from ...tracking.camera import Camera
from ...tracking.footage import Clip
from ..elements import GRID, IMPACT, TABLE, Motion, Record, can_encode_av1, display_window, encode_av1, encode_jpegs
from .timelines import on_frames

Array = NDArray[np.float64]

GRID_M = 0.01
"""Spacing of the lines on the table."""
FRUSTUM = 0.1
"""Depth of the camera's frustum as drawn, in distances of the camera from the origin: seen, and not in the way."""


@dataclass(frozen=True, eq=False)
class SceneBounds:
    """The box that holds the throw, and from where it is looked at."""

    low_m: Array
    """(3,) lowest corner; on the table."""
    high_m: Array
    """(3,) highest corner."""
    eye_m: Array
    """(3,)."""
    frames: tuple[int, int]
    """First and last frame with a pose."""

    @property
    def target_m(self) -> Array:
        """(3,) the middle of the box."""
        return np.asarray(0.5 * (self.low_m + self.high_m))


def scene_bounds_of(solid: Solid, motions: Sequence[Motion], camera: Camera | None) -> SceneBounds:
    """The box of the first motion that has poses: the model's may go on far beyond what was seen."""
    shown = next((motion for motion in motions if len(motion.frame)), None)
    if shown is None:
        low, high, frames = np.full(3, -0.05), np.full(3, 0.05), (0, 1)
    else:
        corners = shown.corners_m(solid)
        low, high = corners.min((0, 1)), corners.max((0, 1))
        frames = int(shown.frame[0]), int(shown.frame[-1])
    low[2] = 0.0
    return SceneBounds(low, high, eye_of(low, high, camera.centre_m if camera is not None else None), frames)


def eye_of(low_m: Array, high_m: Array, camera_m: Array | None = None) -> Array:
    """From where a box fills a view: from the camera's side of the table, else from the front, right and above."""
    target = 0.5 * (low_m + high_m)
    direction = camera_m - target if camera_m is not None else np.array([0.35, -0.85, 0.45])
    return np.asarray(target + direction / np.linalg.norm(direction) * 0.95 * float(np.linalg.norm(high_m - low_m)))


def send_table(recording: rr.RecordingStream, low_m: Array, high_m: Array) -> None:
    """A square round a box with lines every 10 mm, just below z = 0: a face that lies on it stays in front."""
    middle = np.round(0.5 * (low_m + high_m)[:2] / GRID_M) * GRID_M
    half = GRID_M * np.ceil((0.5 * float((high_m - low_m)[:2].max()) + 0.01) / GRID_M)
    ticks = np.arange(-half, half + 0.5 * GRID_M, GRID_M)
    corners = [(x, y, -5e-5) for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]
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


def send_footage(recording: rr.RecordingStream, record: Record) -> tuple[str, ...]:
    """The camera and its film, where there are any; what a reader should know of the picture."""
    if record.camera is not None:
        _send_camera(recording, record.camera)
    if record.clip is None:
        return ("There is no film in this recording.",)
    return _send_film(recording, record.clip)


def _send_camera(recording: rr.RecordingStream, camera: Camera) -> None:
    recording.log("world/camera", rr.Transform3D(translation=camera.centre_m, mat3x3=camera.rotation.T), static=True)
    recording.log(
        "world/camera",
        rr.Pinhole(
            image_from_camera=np.add(camera.matrix, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]),
            resolution=(camera.width_px, camera.height_px),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=FRUSTUM * float(np.linalg.norm(camera.centre_m)),
            color=IMPACT,
        ),
        static=True,
    )


def _send_film(recording: rr.RecordingStream, clip: Clip) -> tuple[str, ...]:
    """The clip as AV1, or as JPEGs where this FFmpeg has no encoder for it."""
    window = display_window(clip)
    entity, frames = "world/camera/image", clip.first_frame + np.arange(len(clip), dtype=np.int64)
    said = []
    if clip.bit_depth > 8:
        levels = f"{window.black:.0f} to {window.white:.0f}"
        said.append(f"The film shows grey levels {levels} of {clip.bit_depth} bits as black to white.")
    if can_encode_av1():
        film = rr.AssetVideo(contents=encode_av1(clip, window), media_type="video/mp4")
        stamps = film.read_frame_timestamps_nanos()
        assert len(stamps) == len(clip), f"{len(stamps)} frames in the film of {len(clip)}"
        recording.log(entity, film, static=True)
        recording.send_columns(entity, on_frames(frames, clip.times_s), rr.VideoFrameReference.columns_nanos(stamps))
    else:
        said.append("The film is stored as JPEG pictures, because no AV1 encoder was found.")
        for number, picture in enumerate(encode_jpegs(clip, window)):
            row = on_frames(frames[number : number + 1], clip.times_s[number : number + 1])
            recording.send_columns(entity, row, rr.EncodedImage.columns(blob=[picture], media_type=["image/jpeg"]))
    return tuple(said)
