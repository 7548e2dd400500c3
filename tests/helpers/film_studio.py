"""A small studio for tests of rendering: a camera, a die in flight, and whether there is a renderer."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from diethrow.model.rotations import quat_from_rotvec
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.camera import Camera

with_mitsuba = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed (pip install 'diethrow[film]')"
)


def camera(distortion: float = 0.0, size: int = 96) -> Camera:
    """A camera 35 degrees above the table at 0.5 m; a 16 mm cube is 35 px wide."""
    pitch = np.radians(35.0)
    ahead = np.array([0.0, np.cos(pitch), -np.sin(pitch)])
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.array([right, np.cross(ahead, right), ahead])
    matrix = np.array([[1100.0, 0.0, size / 2 + 3.2], [0.0, 1100.0, size / 2 - 4.6], [0.0, 0.0, 1.0]])
    lens = np.array([distortion, 0.0, 0.0, 0.0, 0.0])
    return Camera(size, size, matrix, lens, rotation, -rotation @ (np.array([0.0, 0.0, 0.012]) - 0.5 * ahead))


def flight(position: tuple[float, float, float], velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Throw:
    turned = quat_from_rotvec(np.array([0.4, 0.3, 0.5]))
    start = State(0.0, np.array(position), turned, np.array(velocity), np.zeros(3))
    return Throw((Flight(start, np.inf),), ())
