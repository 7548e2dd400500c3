"""Footage whose truth is known: sharp convex dice drawn through a camera over a textured table.

The picture meets the assumptions of the tracker: each face has one grey level, edges are blurred by a Gaussian of known
width, and noise is white. Shadows, motion blur, occluders and a rolling shutter are optional.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from random_throws import random_quaternion
from replay_records import ArrayClip

from diethrow.model.die.die import Die, make_die
from diethrow.model.die.solid import SHAPES, Solid
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.camera import Camera
from diethrow.tracking.picture import PixelNoise
from diethrow.tracking.picture.view import View, make_view

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FPS = 1500.0
FINER = 4
"""Supersampling factor, also of the coverage: edges are accurate to 0.005 px."""
MOMENTS = 9
"""Instants averaged over an exposure: two pixels of motion give steps of a quarter pixel, less than the blur."""
BANDS = 12
"""Parts of a picture between which a rolling shutter is interpolated: a die moves by a tenth of a pixel in one."""
LIGHT = np.array([0.35, -0.55, 0.76])
"""Direction to the lamp."""
SOFT_SHADOW, SOFT_SHADOW_PX = 0.2, 10.0
"""Light that a soft shadow takes beside a die, and the distance over which that fades to a third."""
REACH_M = 0.011
"""Circumradius of every die, which is then 80 px across."""


def die_of(shape: str, mass_kg: float = 0.005) -> Die:
    """One of the five dice; all have the same circumradius, so that they appear equally large."""
    unit = make_die(shape, 1.0, 1.0).solid.circumradius
    return make_die(shape, REACH_M / unit, mass_kg)


DICE = {shape: die_of(shape) for shape in SHAPES}


@dataclass(frozen=True, eq=False)
class Spot:
    """A mark on a face: a convex patch of another reflectance."""

    face: int
    outline_m: Array
    """(n, 3) body axes, in the plane of the face."""
    reflectance: float
    """Relative to that of the face."""


PIPS: dict[int, list[tuple[float, float]]] = {
    1: [(0, 0)],
    2: [(-1, -1), (1, 1)],
    3: [(-1, -1), (0, 0), (1, 1)],
    4: [(-1, -1), (-1, 1), (1, -1), (1, 1)],
    5: [(-1, -1), (-1, 1), (0, 0), (1, -1), (1, 1)],
    6: [(-1, -1), (-1, 0), (-1, 1), (1, -1), (1, 0), (1, 1)],
}


def pips(cube: Die, reflectance: float = 0.15) -> tuple[Spot, ...]:
    """The pips of a cube whose face k carries k + 1: radius 0.09 edges, a quarter of an edge from the middle."""
    edge = cube.solid.edge_m
    angles = 2.0 * np.pi * np.arange(24) / 24
    circle = 0.09 * edge * np.stack([np.cos(angles), np.sin(angles)], 1)
    spots = []
    for f, face in enumerate(cube.solid.faces):
        corners = cube.solid.vertices[list(face)]
        along, across = (corners[1] - corners[0]) / edge, (corners[3] - corners[0]) / edge
        for place in PIPS[f + 1]:
            flat = circle + 0.25 * edge * np.array(place)
            spots.append(Spot(f, corners.mean(0) + flat @ np.array([along, across]), reflectance))
    return tuple(spots)


@dataclass(frozen=True, eq=False)
class Studio:
    """Camera, empty table, and the blur, noise and exposure of the sensor."""

    camera: Camera
    table: Image
    """(height, width) grey levels of the empty table."""
    blur_px: float = 0.7
    noise_grey: float = 0.0
    shadow: float = 0.0
    """Share of the light that the shadow of the die removes from the table."""
    exposure_s: float = 0.0
    readout_s: float = 0.0
    """Time from the exposure of the first row to that of the last."""

    def view(self, die: Die) -> View:
        """The view of the tracker, with the true values."""
        noise = max(self.noise_grey, 0.5)
        return make_view(
            self.camera, die, self.table, PixelNoise(noise), self.exposure_s, self.blur_px, readout_s=self.readout_s
        )


def studio(width_px: int = 200, height_px: int = 200, focal_px: float = 1500.0, distance_m: float = 0.4) -> Studio:
    """A camera with slight distortion, inclined by 35 degrees to a textured table."""
    pitch, heading = np.radians(35.0), np.radians(20.0)
    ahead = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), -np.sin(pitch)])
    target = np.array([0.0, 0.0, 0.018])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    middle = ((width_px - 1) / 2, (height_px - 1) / 2)
    matrix = np.array([[focal_px, 0.0, middle[0]], [0.0, focal_px, middle[1]], [0.0, 0.0, 1.0]])
    distortion = np.array([0.08, 0.0, 2e-4, -1e-4, 0.0])
    camera = Camera(width_px, height_px, matrix, distortion, rotation, -rotation @ (target - distance_m * ahead))
    clouds = np.random.default_rng(7).normal(size=(height_px, width_px))
    texture = cv2.GaussianBlur(clouds, (0, 0), 3.0)
    return Studio(camera, np.asarray(75.0 + 7.0 * texture / texture.std(), np.float32))


def softly_shaded(room: Studio, points_m: Array) -> Studio:
    """The studio with a table that gets darker towards the outline of some points (n, 3), by SOFT_SHADOW where it touches it."""
    outline = cv2.convexHull(room.camera.project(points_m).astype(np.float32))
    outside = np.ones(room.table.shape, np.uint8)
    cv2.fillConvexPoly(outside, np.rint(outline).astype(np.int32), 0)
    away_px = cv2.distanceTransform(outside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return replace(
        room, table=np.asarray(room.table * (1.0 - SOFT_SHADOW * np.exp(-away_px / SOFT_SHADOW_PX)), np.float32)
    )


def still(rng: np.random.Generator, height_m: float = 0.018) -> State:
    """A die at rest near the middle of the studio, in a random orientation."""
    return State(0.0, np.array([0.001, -0.002, height_m]), random_quaternion(rng), np.zeros(3), np.zeros(3))


def falling_cube(duration_s: float, height_m: float = 0.028, fall_m_s: float = 0.6, spin_rad_s: float = 20.0) -> Throw:
    """A cube that falls, and by default bounces once in the first 64 frames, at 24.3 ms, and stays in the picture. The components
    of its angular velocity have the standard deviation `spin_rad_s`."""
    rng = np.random.default_rng(1)
    above, down = np.array([-0.002, 0.0, height_m]), np.array([0.05, 0.05, -fall_m_s])
    release = State(0.0, above, random_quaternion(rng), down, spin_rad_s * rng.normal(size=3))
    return throw_die(DICE["cube"], release, SmoothImpact(0.6), until=Until(time_s=duration_s)).throw


@cache
def fast_cube(frames: int) -> Throw:
    """A falling cube that bounces, at 60 rad/s before the first bounce and 1.2 m/s, through a number of frames."""
    slow = falling_cube(frames / FPS)
    start = slow.flights[0].start
    spin = 60.0 * start.omega_rad_s / np.linalg.norm(start.omega_rad_s)
    release = replace(start, velocity_m_s=np.array([0.1, 0.1, -0.9]), omega_rad_s=spin)
    return throw_die(DICE["cube"], release, SmoothImpact(0.6), until=Until(time_s=frames / FPS)).throw


def photograph(
    room: Studio, die: Die, state: State | None, rng: np.random.Generator | None = None, spots: tuple[Spot, ...] = ()
) -> Image:
    """One frame (height, width) of the die in motion at mid-exposure `state`, or of the empty table; not rounded."""
    picture = room.table.astype(float)
    if state is not None:
        moments = (np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5 if room.exposure_s else np.zeros(1)
        flight = Flight(state, np.inf)
        instants = [flight.at(state.time_s + float(m) * room.exposure_s) for m in moments]
        picture = np.mean([_still(room, die, instant, spots) for instant in instants], axis=0)
    if rng is not None and room.noise_grey:
        picture = picture + rng.normal(scale=room.noise_grey, size=picture.shape)
    return np.asarray(picture, np.float32)


def photograph_by_rows(room: Studio, die: Die, throw: Moving, time_s: float) -> Array:
    """One frame (height, width) of a rolling shutter, without noise: each row is exposed at an instant of its own, the middle
    row at `time_s`."""
    height = room.camera.height_px
    place = (np.arange(height) / (height - 1)) * BANDS
    delays = (np.arange(BANDS + 1) / BANDS - 0.5) * room.readout_s
    pictures = [photograph(room, die, throw.at(time_s + float(delay))).astype(float) for delay in delays]
    first = np.minimum(place.astype(int), BANDS - 1)
    share = (place - first)[:, None]
    rows = np.arange(height)
    stack = np.array(pictures)
    return np.asarray((1.0 - share) * stack[first, rows] + share * stack[first + 1, rows])


class Moving(Protocol):
    """A motion with a state at every instant."""

    def at(self, time_s: float) -> State: ...


def film(
    room: Studio, die: Die, throw: Moving, frames: int, *, bit_depth: int = 8, seed: int = 1, fps: float = FPS,
    spots: tuple[Spot, ...] = (),
) -> ArrayClip:  # fmt: skip
    """The throw from time zero, rounded to grey levels; 12 bits resolve the same light 16 times finer than 8."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / fps
    scale, dtype = 2.0 ** (bit_depth - 8), np.uint8 if bit_depth <= 8 else np.uint16
    stack = [
        np.clip(np.rint(scale * _frame(room, die, throw, float(t), rng, spots)), 0, 2**bit_depth - 1) for t in times
    ]
    return ArrayClip(np.array(stack).astype(dtype), times, bit_depth)


def _frame(
    room: Studio, die: Die, throw: Moving, time_s: float, rng: np.random.Generator, spots: tuple[Spot, ...]
) -> Array:
    if room.readout_s == 0.0:
        return np.asarray(photograph(room, die, throw.at(time_s), rng, spots))
    picture = photograph_by_rows(room, die, throw, time_s)
    return np.asarray(picture + rng.normal(scale=room.noise_grey, size=picture.shape))


def greys(die: Die, rotation: Array) -> Array:
    """Grey level of each face: Lambertian, with slightly different paint on every face."""
    lit = np.maximum(die.solid.normals @ rotation.T @ LIGHT, 0.0)
    paint = 1.0 + 0.12 * np.sin(2.4 * np.arange(len(lit)))
    return np.asarray((115.0 + 90.0 * lit) * paint)


def _still(room: Studio, die: Die, state: State, spots: tuple[Spot, ...]) -> Array:
    """The picture of a die that does not move: blur(faces) + table · (1 - blur(coverage))."""
    camera, rotation = room.camera, state.rotation
    corners = die.solid.vertices @ rotation.T + state.position_m
    table = room.table.astype(float)
    if room.shadow:
        fallen = corners[:, :2] - corners[:, 2:] / LIGHT[2] * LIGHT[:2]
        ground = camera.project(np.column_stack([fallen, np.zeros(len(fallen))]))
        outline = cv2.convexHull(ground.astype(np.float32))[:, 0].astype(float)
        table = table * (1.0 - room.shadow * _drawn(room, [outline], np.ones(1), 2.0)[1])
    faces = [f for f in range(len(die.solid.faces)) if _faces_camera(die.solid, f, rotation, state, camera)]
    outlines = [_outline(camera, corners[list(die.solid.faces[f])]) for f in faces]
    light = greys(die, rotation)
    # A mark changes the light of a face and adds no coverage.
    marks = [spot for spot in spots if spot.face in faces]
    outlines += [_outline(camera, spot.outline_m @ rotation.T + state.position_m) for spot in marks]
    values = [*light[faces], *((spot.reflectance - 1.0) * light[spot.face] for spot in marks)]
    covers = np.repeat([1.0, 0.0], [len(faces), len(marks)])
    light, cover = _drawn(room, outlines, np.array(values), np.sqrt(max(room.blur_px**2 - 1.0 / 12.0, 0.01)), covers)
    return np.asarray(light + table * (1.0 - cover))


def _faces_camera(solid: Solid, f: int, rotation: Array, state: State, camera: Camera) -> bool:
    gap = rotation @ solid.normals[f] @ (camera.centre_m - state.position_m)
    return bool(gap > solid.offsets[f])


def _outline(camera: Camera, corners: Array) -> Array:
    """Outline of a face [px], with a point half-way along each edge, because distortion bends edges."""
    shares = np.arange(2)[:, None, None] / 2.0
    between = corners + shares * (np.roll(corners, -1, 0) - corners)
    return camera.project(between.transpose(1, 0, 2).reshape(-1, 3))


def _drawn(
    room: Studio, outlines: list[Array], values: Array, blur_px: float, covers: Array | None = None
) -> tuple[Array, Array]:
    """Convex outlines filled with their values, and their coverage (1 unless `covers` says otherwise), both blurred,
    pixels averaged over their area."""
    covers = np.ones(len(outlines)) if covers is None else covers
    height, width = room.table.shape
    light, cover = np.zeros((height, width)), np.zeros((height, width))
    everything = np.concatenate(outlines)
    low = np.maximum(np.floor(everything.min(0) - 5.0 * blur_px - 2.0), 0).astype(int)
    high = np.minimum(np.ceil(everything.max(0) + 5.0 * blur_px + 2.0), [width - 1, height - 1]).astype(int) + 1
    if (high - low < 2).any():
        return light, cover
    # The fine grid extends beyond the border of the picture, so that the blur includes what lies outside.
    x, y = (np.arange((low[a] - 4) * FINER, (high[a] + 4) * FINER) / FINER - 0.5 + 0.5 / FINER for a in (0, 1))
    fine = np.zeros((2, len(y), len(x)))
    for outline, value, covered in zip(outlines, values, covers, strict=True):
        (x0, y0), (x1, y1) = (outline.min(0) - (x[0], y[0])) * FINER - 2, (outline.max(0) - (x[0], y[0])) * FINER + 3
        rows, columns = slice(max(int(y0), 0), max(int(y1), 0)), slice(max(int(x0), 0), max(int(x1), 0))
        share = _coverage(outline, x[columns], y[rows])
        fine[:, rows, columns] += share * np.array([value, covered])[:, None, None]
    for image, target in zip(fine, (light, cover), strict=True):
        soft = cv2.GaussianBlur(image, (0, 0), blur_px * FINER)
        coarse = soft.reshape(len(y) // FINER, FINER, len(x) // FINER, FINER).mean((1, 3))
        target[low[1] : high[1], low[0] : high[0]] = coarse[4:-4, 4:-4]
    return light, cover


def _coverage(outline: Array, x: Array, y: Array) -> Array:
    """Share (y, x) of each fine cell inside a convex outline: the edge nearest to the cell decides."""
    step = np.roll(outline, -1, 0) - outline
    normal = np.stack([-step[:, 1], step[:, 0]], 1) / np.linalg.norm(step, axis=1)[:, None]
    normal *= np.sign(((outline.mean(0) - outline) * normal).sum(1))[:, None]
    share = np.ones((len(y), len(x)))
    for corner, (a, b) in zip(outline, normal, strict=True):
        distance = (b * (y - corner[1]))[:, None] + (a * (x - corner[0]))[None, :]
        np.minimum(share, np.clip(0.5 + FINER * distance, 0.0, 1.0), out=share)
    return share
