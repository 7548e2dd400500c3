"""A small record to draw: two flights, one impact, some lost frames, and a clip whose frames show their numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diethrow.fitting.predict.sequential import Estimate
from diethrow.fitting.results import Effect, Fit, Parameter
from diethrow.model.die.die import Die, make_die
from diethrow.model.rotations import continuous_sign, quat_from_matrix, quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Flight, Impact, State, Throw, energy_J
from diethrow.replay.elements.record import Record
from diethrow.tracking.camera import Camera
from diethrow.tracking.footage.clip import Frame
from diethrow.tracking.track import ABSENT, LOST, TRACKED, Track

Array = NDArray[np.float64]

FPS = 1500.0
FRAMES = 60
FIRST_FRAME = 7
"""The clip begins in the middle of a file, so frame numbers differ from row numbers."""
IMPACT_S = 0.0234567891
"""Between two frames."""
WIDTH_PX, HEIGHT_PX = 97, 88
"""Odd sizes, because the video encoder needs even ones."""
CODE_BITS, CODE_PX = 8, 10


@dataclass(frozen=True, eq=False)
class ArrayClip:
    """A clip in memory."""

    array: NDArray[Any]
    times_s: Array
    bit_depth: int = 8
    first_frame: int = 0
    notices: tuple[str, ...] = ()

    @property
    def width_px(self) -> int:
        return int(self.array.shape[2])

    @property
    def height_px(self) -> int:
        return int(self.array.shape[1])

    def __len__(self) -> int:
        return len(self.array)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        yield from self.array[start:stop]

    def frame(self, index: int) -> Frame:
        return np.asarray(self.array[index])

    def metadata(self) -> dict[str, Any]:
        return {}


def coded_clip(count: int = FRAMES, *, bit_depth: int = 8) -> ArrayClip:
    """Grey frames whose number stands in each as a row of black and white squares."""
    white = 2**bit_depth - 1
    frames = np.full((count, HEIGHT_PX, WIDTH_PX), white // 2, np.uint8 if bit_depth <= 8 else np.uint16)
    for k in range(count):
        for bit in range(CODE_BITS):
            square = slice(bit * CODE_PX, (bit + 1) * CODE_PX)
            frames[k, :CODE_PX, square] = white * (k >> bit & 1)
    return ArrayClip(frames, (FIRST_FRAME + np.arange(count)) / FPS, bit_depth, FIRST_FRAME)


def code_of(frame: NDArray[np.uint8]) -> int:
    """The number that was burned into a frame."""
    squares = [frame[2 : CODE_PX - 2, bit * CODE_PX + 2 : (bit + 1) * CODE_PX - 2].mean() for bit in range(CODE_BITS)]
    return sum(1 << bit for bit, level in enumerate(squares) if level > 127)


def camera() -> Camera:
    """A camera with distortion, half a metre from the die and slightly above the table."""
    centre, target = np.array([0.1, -0.45, 0.2]), np.array([0.0, 0.0, 0.02])
    ahead = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    matrix = np.array([[600.0, 0.0, 48.0], [0.0, 600.0, 44.0], [0.0, 0.0, 1.0]])
    return Camera(WIDTH_PX, HEIGHT_PX, matrix, np.array([0.1, 0.0, 1e-3, 0.0, 0.0]), rotation, -rotation @ centre)


def die() -> Die:
    """A wooden cube of 16 mm."""
    return make_die("cube", 0.016, 0.0048)


def throw() -> Throw:
    """A fall on a corner and a rise; the velocities are chosen, not simulated."""
    cube = die()
    down = np.array([0.1, 0.05, -0.6])
    corner = cube.solid.vertices[0] / np.linalg.norm(cube.solid.vertices[0])
    stand = quat_from_matrix(_rotation_to(corner, np.array([0.0, 0.0, -1.0])))
    spin = np.array([30.0, -20.0, 10.0])
    touch = State(IMPACT_S, np.array([0.0, 0.0, cube.solid.circumradius]), stand, down, spin)
    before = Flight(touch, IMPACT_S).at((FIRST_FRAME + 0.5) / FPS)
    after = replace(touch, velocity_m_s=np.array([0.1, 0.05, 0.35]), omega_rad_s=np.array([-40.0, 10.0, 10.0]))
    impact = Impact(
        IMPACT_S,
        "vertex",
        (0,),
        np.zeros(2),
        np.array([0.0, 0.0, 0.005]),
        -0.6,
        0.35,
        energy_J(cube, touch),
        energy_J(cube, after),
        3,
        4,
        sigma_time_s=1e-5,
        chi=0.583,
        chi_low=0.55,
        chi_high=0.61,
    )
    return Throw((Flight(before, IMPACT_S), Flight(after, (FIRST_FRAME + FRAMES) / FPS)), (impact,))


def track(moved_m: float = 0.0, *, gaps: bool = True) -> Track:
    """The throw on the frames of the clip, shifted along x; frames 0 to 2 are absent, 30 to 33 lost."""
    frame = FIRST_FRAME + np.arange(FRAMES)
    positions, quaternions = throw().poses(frame / FPS)
    positions[:, 0] += moved_m
    covariance = np.tile(np.diag([1e-5**2] * 3 + [1e-3**2] * 3), (FRAMES, 1, 1))
    status = np.full(FRAMES, TRACKED, dtype="<U7")
    if gaps:
        status[:3], status[30:34] = ABSENT, LOST
        for values in (positions, quaternions, covariance):
            values[status != TRACKED] = np.nan
    return Track(frame, frame / FPS, positions, continuous_sign(quaternions), covariance, status)


def fit(**changes: Any) -> Fit:
    """A fit of χ alone."""
    found = Fit(
        parameters={
            "chi": Parameter(0.5831, 0.5802, 0.5859, 0.95, True, False),
            "mu": Parameter(None, None, None, None, False, False),
        },
        initial=throw().flights[0].start,
        initial_covariance=1e-8 * np.eye(12),
        chosen=(),
        considered=(Effect("friction", None, "No contact slides."),),
        bounces_fitted=1,
        residual_rms=1.04,
        landed_face=None,
        face_odds=None,
        messages=("The friction coefficient mu has no effect on a smooth impact.",),
        throw=throw(),
    )
    return replace(found, **changes)


def estimates() -> tuple[Estimate, ...]:
    """The odds of the faces after the only bounce."""
    return (Estimate(1, IMPACT_S, Parameter(0.583, 0.58, 0.586, 0.95, True, False), {1: 0.0, 2: 0.25, 3: 0.75}),)


def record(**changes: Any) -> Record:
    """A complete record: clip, camera, fit and both tracks."""
    whole = Record(
        title="a throw",
        die=die(),
        track=track(),
        measured=throw(),
        fps=FPS,
        clip=coded_clip(),
        camera=camera(),
        fit=fit(),
        simulated=track(1e-5, gaps=False),
        estimates=estimates(),
        notices=("The last frame is cut off.",),
    )
    return replace(whole, **changes)


def turned(quaternions: Array, rotvec_rad: Array) -> Array:
    """Orientations rotated by a constant rotation in world axes."""
    return quat_multiply(quat_from_rotvec(rotvec_rad), quaternions)


def _rotation_to(start: Array, end: Array) -> Array:
    """A rotation matrix (3, 3) that takes the unit vector `start` to `end`; they must not be opposite."""
    axis = np.cross(start, end)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + float(start @ end)))
