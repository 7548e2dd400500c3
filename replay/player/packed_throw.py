"""A throw as the data of the player: poses, the corners in the picture, bounces and the die, as JSON within the page.

| entry | what |
| --- | --- |
| `vertices`, `faces`, `labels` | corners [m] in the body frame, their indices by face, and the face's number |
| `frame`, `time_ms` | (n,) int32 and float32 |
| `motions` | `name`, `colour`; `poses` (n, 7) float32 [m, wxyz], NaN without one; `corners` (n, vertices, 2) int16, or null |
| `picture_px` | width and height of the picture, null without one; then `corners` are null as well |
| `impacts` | all bounces in their order: `time_ms`, `place_m` (x, y), null where it is not known |
| `view` | azimuth and elevation [rad] of the eye, seen from the throw: those of the camera |
| `grid_m` | distance of the lines on the table |

Arrays are little-endian, in base64. Corners are in eighths of a pixel of the picture.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...model.die import Solid
from ...model.throw import Impact
from ..elements import COLOURS, Motion, hex_colour

if TYPE_CHECKING:
    from ...tracking.camera import Camera

Array = NDArray[np.float64]

MOST_FRAMES = 1200
"""Frames in a page; of a longer clip it has every n-th. A screen shows 60 a second, and a frame takes about 100 bytes."""
CORNER_UNITS = 8
"""Units of a corner's place in one pixel of the picture."""
UNKNOWN = -32768
"""In the place of a corner that the camera does not see, or too far away to store."""
USUAL_VIEW = (-1.1, 0.35)
"""Azimuth and elevation [rad] of the eye where no camera says another."""
LINES = 8
"""Lines of the table's grid across the throw, at most."""
GRIDS_M = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Distances of these lines to choose from."""


def shown_frames(motions: Sequence[Motion]) -> tuple[NDArray[np.int64], int]:
    """The frames of the player, from the first pose to the last, and their distance in frames of the tracks."""
    known = np.unique(np.concatenate([motion.frame for motion in motions]))
    step = -(-len(known) // MOST_FRAMES)
    return known[::step], step


def packed_throw(
    solid: Solid,
    motions: Sequence[Motion],
    impacts: Sequence[Impact],
    camera: Camera | None,
    grid_m: float,
) -> str:
    """The JSON. Without a camera there are no corners in the picture."""
    frame, _ = shown_frames(motions)
    times = dict(np.concatenate([np.stack([m.frame, m.time_s], 1) for m in reversed(motions)]).tolist())
    data = {
        "vertices": [[round(value, 9) for value in vertex] for vertex in solid.vertices.tolist()],
        "faces": [list(face) for face in solid.faces],
        "labels": list(range(1, len(solid.faces) + 1)),
        "frame": _text(frame.astype("<i4")),
        "time_ms": _text(np.array([1e3 * times[k] for k in frame.tolist()]).astype("<f4")),
        "motions": [_motion(solid, motion, frame, camera) for motion in motions],
        "picture_px": None if camera is None else [camera.width_px, camera.height_px],
        "impacts": [_impact(impact) for impact in impacts],
        "view": list(USUAL_VIEW if camera is None else _view(camera, motions[0])),
        "grid_m": grid_m,
    }
    # No text of the page can end the element that holds it.
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def grid_distance_m(motions: Sequence[Motion]) -> float:
    """The distance of the table's lines for throws of this extent."""
    places = np.concatenate([motion.position_m[:, :2] for motion in motions])
    extent = float(np.ptp(places, axis=0).max())
    return next((each for each in GRIDS_M if each * LINES >= extent), GRIDS_M[-1])


def _motion(solid: Solid, motion: Motion, frame: NDArray[np.int64], camera: Camera | None) -> dict[str, Any]:
    row, known = np.searchsorted(motion.frame, frame), np.isin(frame, motion.frame)
    poses = np.full((len(frame), 7), np.nan)
    poses[known] = np.hstack([motion.position_m, motion.quaternion])[row[known]]
    corners = None
    if camera is not None:
        places = np.full((len(frame), len(solid.vertices), 2), np.nan)
        places[known] = camera.project(motion.corners_m(solid)[row[known]])
        with np.errstate(invalid="ignore"):
            units = np.rint(CORNER_UNITS * places)
            fits = np.isfinite(units).all(-1, keepdims=True) & (abs(units) < -UNKNOWN).all(-1, keepdims=True)
        corners = _text(np.where(fits, units, UNKNOWN).astype("<i2"))
    return {
        "name": motion.name,
        "colour": hex_colour(COLOURS[motion.name]),
        "poses": _text(poses.astype("<f4")),
        "corners": corners,
    }


def _impact(impact: Impact) -> dict[str, Any]:
    place_m = np.round(impact.point_m, 6).tolist() if np.isfinite(impact.point_m).all() else None
    return {"time_ms": round(1e3 * impact.time_s, 4), "place_m": place_m}


def _view(camera: Camera, motion: Motion) -> tuple[float, float]:
    """Azimuth and elevation [rad] of the camera, seen from the middle of the throw."""
    x, y, z = (camera.centre_m - motion.position_m.mean(0)).tolist()
    return round(float(np.arctan2(y, x)), 4), round(float(np.arctan2(z, np.hypot(x, y))), 4)


def _text(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
