"""A camera's view of a throw: path-traced with Mitsuba 3 (Jakob et al., 2022), pixel for pixel what footage would hold.

What is drawn: the die with its marks and rounded corners, in glossy paint; a textured or reflecting table; a lamp of
finite size, whose shadow has soft borders, and the dim light of a room; the die's contact shadow, its image in a mirror,
glare. The camera is the calibrated one, lens distortion included.

**Mirror.** A reflecting table is a window into the mirrored scene: image die, image lamp and image room below it, seen
and shining through a film that lets `REFLECTANCE` pass (method of images). That is exact for a plane, and free of the
sparks that a path tracer makes of lamp light that reaches the die by way of a mirror.

**Exposure.** A frame is the mean over instants spread evenly through the exposure, so many that no corner moves more than
`MOMENT_PX` between two of them: motion blur as it is, also across an impact.

**Lens.** The point spread is a Gaussian that includes the pixel's area. A distorted or skew camera is rendered as an ideal
one, twice as fine, and brought onto the real pixels by cubic splines: Mitsuba's cameras have no distortion.

**Effort.** The empty table is rendered once, well. Of every frame only windows about the die, its shadow and its mirror
image are rendered, and blended into the empty table over `FEATHER_PX`.

Nothing here computes physics: the poses are those of the `Throw` that is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ..model.motion import Throw
from ..model.rotations import matrix_from_quat
from ..model.solids import Die
from ..tracking.camera import Camera
from .skin import Mesh, die_mesh, face_paint
from .surfaces import WIDTH_M, is_mirror, table_paint

Array = NDArray[np.float64]
Point = tuple[float, float, float]

MOMENT_PX = 0.4
"""Below the lens blur, so that the instants of an exposure run together."""
MOST_MOMENTS = 24
"""Motion blur beyond 10 px falls into steps; such footage is beyond use anyway."""
FEATHER_PX = 8
"""Over which a window goes over into the empty table: where it ends, the die's influence is below a grey level."""
FINER = 2
"""A distorted picture is rendered so many times finer."""
FINE_FILTER_PX = 0.5
"""Standard deviation of the fine picture's own pixel filter, in fine pixels: what a cubic spline still follows."""
EMPTY_EFFORT = 4
"""The empty table gets so many times the samples of a frame."""
UPSIDE_DOWN = np.array([1.0, 1.0, -1.0])
MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0])
"""A point to its image in the table."""
CHUNK_PX_SAMPLES = 40_000_000
"""Samples that Mitsuba draws at once: 2 GB in its vectorised variants."""
TABLE_HALF_M = 2.0
MOST_TURNS = 200
"""Of the fixed point that undoes a distortion; real lenses need a dozen."""
REFLECTANCE = 0.8
"""Of a mirror table, where no dust lies: a front-coated one has 0.9, a glass one less."""
DEPTH = 5
"""Of the light paths: lamp, table, die, table, eye."""


class NoRendererError(ValueError):
    """Mitsuba, which comes with the extra `film`, is not installed."""


@dataclass(frozen=True)
class Look:
    """The scene but for die, table and camera: paint, lamp, and what stands in front."""

    lamp_m: Point
    """Middle of the square lamp, which faces the origin; world."""
    lamp_side_m: float = 0.08
    fill: float = 0.25
    """Light of the room, as a part of the lamp's at the origin."""
    paint: float = 0.75
    """Reflectance of the die."""
    ink: float = 0.03
    """Reflectance of its marks."""
    roughness: float = 0.15
    """Of its gloss: 0.05 a mirror's, 0.5 dull."""
    grain: float = 0.015
    """Relative standard deviation of the die's paint."""
    table_tone: float = 1.0
    """Factor on the reflectance of the table."""
    brightest: float = 0.8
    """Part of the sensor's range that a face turned to the lamp fills, gloss apart."""
    rods_m: tuple[tuple[Point, Point, float], ...] = ()
    """Rods in the picture: both ends and the radius, world."""
    seed: int = 1
    """Of the table's texture and the paint's grain."""


@dataclass(frozen=True)
class Effort:
    """What rendering may cost."""

    samples: int = 48
    """Light paths for each pixel of a frame. The noise they leave is to stay below the sensor's."""
    threads: int = 1
    variant: str = "scalar_rgb"
    """Of Mitsuba. `llvm_ad_mono` is twice as fast where a recent LLVM library is installed."""

    def __post_init__(self) -> None:
        if self.samples < 1 or self.threads < 1:
            raise ValueError(f"samples = {self.samples}, threads = {self.threads}: wanted 1 or more of each")


def lamp_beside(camera: Camera, distance_m: float = 0.6) -> Point:
    """A place for the lamp, 50 degrees high and 55 degrees to the left of the camera: three faces get three shades."""
    away = camera.centre_m[:2] / max(float(np.linalg.norm(camera.centre_m[:2])), 1e-9)
    turn, rise = np.radians(-55.0), np.radians(50.0)
    across = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ away
    x, y = distance_m * np.cos(rise) * across
    return float(x), float(y), float(distance_m * np.sin(rise))


def film_light(studio: Studio, throw: Throw, times_s: Array, exposure_s: float) -> Iterator[Array]:
    """The light (height, width) of each frame, 1.0 where it fills the sensor; `times_s` (n,) are mid-exposures."""
    for number, time_s in enumerate(times_s):
        yield studio.light(*_poses(studio, throw, float(time_s), exposure_s), seed=number)


def _poses(studio: Studio, throw: Throw, time_s: float, exposure_s: float) -> tuple[Array, Array]:
    """Positions (m, 3) and quaternions (m, 4) through an exposure, no corner moving much from one to the next."""
    ends = throw.poses(time_s + exposure_s * np.array([-0.5, 0.0, 0.5]))
    corners = studio.corners_px(*ends)
    path = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(1).sum()
    count = int(np.clip(np.ceil(path / MOMENT_PX), 1, MOST_MOMENTS)) if np.isfinite(path) else 1
    share = (np.arange(count) + 0.5) / count - 0.5
    return throw.poses(time_s + exposure_s * share)


class Studio:
    """The scene in Mitsuba, ready to be photographed with the die anywhere. Holds state: one die is moved about."""

    def __init__(
        self, die: Die, camera: Camera, surface: str, look: Look, *, blur_px: float = 0.6, effort: Effort = Effort()
    ) -> None:
        """Raises NoRendererError without Mitsuba, and ValueError for a blur below what pixels have."""
        if blur_px < 0.4:
            raise ValueError(f"blur_px = {blur_px}: wanted 0.4 or more, a pixel alone spreads light over 0.3")
        self.die, self.camera, self.look, self.effort = die, camera, look, effort
        self._mirror = is_mirror(surface)
        self._optics = _optics(camera, blur_px)
        self._mi = _mitsuba(effort)
        self._scene = self._mi.load_dict(_scene(self._mi, die, self._optics, surface, look))
        self._handles = self._mi.traverse(self._scene)
        self._gain = look.brightest * np.pi / (look.paint * (1.0 + look.fill))
        self._empty: Array | None = None

    def corners_px(self, positions_m: Array, quaternions: Array) -> Array:
        """Where the corners of the sharp die are seen (m, corners, 2)."""
        corners = self.die.solid.vertices @ matrix_from_quat(quaternions).transpose(0, 2, 1) + positions_m[:, None]
        return self.camera.project(corners)

    def empty(self) -> Array:
        """The light of the table without the die."""
        if self._empty is None:
            self._place(np.array([0.0, 0.0, -10.0 * TABLE_HALF_M]), np.array([1.0, 0.0, 0.0, 0.0]))
            whole = (0, 0, self.camera.width_px, self.camera.height_px)
            self._empty = self._render(whole, EMPTY_EFFORT * self.effort.samples, seed=2**31)
        return self._empty

    def light(self, positions_m: Array, quaternions: Array, *, seed: int) -> Array:
        """The light of an exposure over poses (m, 3), (m, 4), each for an equal part of it."""
        picture = self.empty().copy()
        samples = max(1, round(self.effort.samples / len(positions_m)))
        for box in self._windows(positions_m, quaternions):
            window = np.zeros((box[3] - box[1], box[2] - box[0]))
            for k, (position, quaternion) in enumerate(zip(positions_m, quaternions, strict=True)):
                self._place(position, quaternion)
                window += self._render(box, samples, seed=seed * MOST_MOMENTS + k) / len(positions_m)
            _blend(picture, window, box)
        return picture

    def _place(self, position_m: Array, quaternion: Array) -> None:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = matrix_from_quat(quaternion), position_m
        self._handles["die.to_world"] = self._mi.Transform4f(pose)
        if self._mirror:
            self._handles["image.to_world"] = self._mi.Transform4f(MIRRORED @ pose @ MIRRORED)
        self._handles.update()

    def _render(self, box: tuple[int, int, int, int], samples: int, *, seed: int) -> Array:
        """The light of a window (left, top, right, bottom) of the real picture."""
        fine = self._optics.rendered_box(box)
        self._handles["sensor.film.crop_offset"] = [fine[0], fine[1]]
        self._handles["sensor.film.crop_size"] = [fine[2] - fine[0], fine[3] - fine[1]]
        self._handles.update()
        samples = max(1, samples // (FINER**2 if self._optics.places is not None else 1))
        at_once = max(1, CHUNK_PX_SAMPLES // ((fine[2] - fine[0]) * (fine[3] - fine[1])))
        passes = int(np.ceil(samples / at_once))
        total = 0.0
        for k in range(passes):
            rendered = self._mi.render(self._scene, spp=int(np.ceil(samples / passes)), seed=(seed * 64 + k) % 2**32)
            total = total + np.asarray(rendered, float)[..., 0] / passes
        return self._gain * self._optics.brought_home(np.asarray(total), box, fine)

    def _windows(self, positions_m: Array, quaternions: Array) -> list[tuple[int, int, int, int]]:
        """Boxes of the picture that the die changes: itself, its shadow and, on a mirror, its image; merged where that
        is less to render."""
        corners = (
            self.die.solid.vertices @ matrix_from_quat(quaternions).transpose(0, 2, 1) + positions_m[:, None]
        ).reshape(-1, 3)
        groups = [self.camera.project(corners), self.camera.project(self._shaded(corners, positions_m))]
        if self._mirror:
            groups.append(self.camera.project(corners * [1.0, 1.0, -1.0]))
        boxes = [box for points in groups if (box := _box(points, self.camera)) is not None]
        return _merged(boxes)

    def _shaded(self, corners_m: Array, positions_m: Array) -> Array:
        """Points round what the die shades on the table: the lamp's shadow, and the ground that it covers closely."""
        half = self.look.lamp_side_m / 2 * np.sqrt(2.0)
        lamp = np.array(self.look.lamp_m)
        lamps = lamp + half * np.array([(0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
        reach = corners_m[None] - lamps[:, None]
        share = lamps[:, None, 2] / np.maximum(lamps[:, None, 2] - corners_m[None, :, 2], 1e-3)
        fallen = (lamps[:, None] + share[..., None] * reach).reshape(-1, 3)
        size, height = self.die.solid.circumradius, float(positions_m[:, 2].min())
        spread = size + min(height, 1.5 * size) if height < 4.0 * size else 0.0
        middle = positions_m.mean(0)
        ground = middle + spread * np.array([(1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0)])
        points = np.concatenate([fallen, ground])
        points[:, 2] = 0.0
        return points


# --- windows ---


def _box(points_px: Array, camera: Camera) -> tuple[int, int, int, int] | None:
    """The box (left, top, right, bottom) about points, with the feather, within the picture."""
    points_px = points_px[np.isfinite(points_px).all(1)]
    if not len(points_px):
        return None
    margin = FEATHER_PX + 4
    left, top = np.maximum(np.floor(points_px.min(0)).astype(int) - margin, 0)
    right, bottom = np.minimum(np.ceil(points_px.max(0)).astype(int) + margin + 1, [camera.width_px, camera.height_px])
    return (int(left), int(top), int(right), int(bottom)) if right > left and bottom > top else None


def _merged(boxes: list[tuple[int, int, int, int]]) -> list[tuple[int, int, int, int]]:
    """The boxes, those that overlap replaced by the one about both: a blended window must not be blended over."""
    done: list[tuple[int, int, int, int]] = []
    for box in boxes:
        for other in list(done):
            if box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]:
                done.remove(other)
                box = (min(box[0], other[0]), min(box[1], other[1]), max(box[2], other[2]), max(box[3], other[3]))
        done.append(box)
    return done if len(done) < 2 or not _overlap(done) else _merged(done)


def _overlap(boxes: list[tuple[int, int, int, int]]) -> bool:
    return any(
        a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for k, a in enumerate(boxes) for b in boxes[:k]
    )


def _blend(picture: Array, window: Array, box: tuple[int, int, int, int]) -> None:
    """Lay a window over the picture; its weight rises from its borders, but for those that are the picture's own."""
    height, width = picture.shape
    left, top, right, bottom = box
    x, y = np.arange(left, right), np.arange(top, bottom)
    ramps = []
    for at, low, high, end in ((x, left, right, width), (y, top, bottom, height)):
        near_low = (at - low + 1) / FEATHER_PX if low > 0 else np.ones(len(at))
        near_high = (high - at) / FEATHER_PX if high < end else np.ones(len(at))
        ramps.append(np.clip(np.minimum(near_low, near_high), 0.0, 1.0))
    weight = ramps[1][:, None] * ramps[0][None, :]
    part = picture[top:bottom, left:right]
    part += weight * (window - part)


# --- camera ---


@dataclass(frozen=True, eq=False)
class _Optics:
    """How the real camera's picture comes from that of an ideal one."""

    width_px: int
    height_px: int
    focal_px: float
    middle_px: tuple[float, float]
    """Principal point of the ideal camera, pixel centres at integers."""
    filter_px: float
    """Standard deviation of the ideal camera's pixel filter, in its own pixels."""
    pose: Array
    """(4, 4) camera to world, in Mitsuba's axes: x left, y up, z ahead."""
    places: Array | None = field(default=None, repr=False)
    """(2, FINER height, FINER width) row and column in the ideal picture of every fine point of the real one; None where
    the ideal camera is the real one."""
    blur_px: float = 0.0
    """What is blurred in addition, in fine pixels."""

    def rendered_box(self, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        """The box of the ideal picture from which a box of the real one is made."""
        if self.places is None:
            return box
        rows, columns = self.places[:, *_fine(box, _room(self.blur_px), self.places.shape)]
        return (
            max(int(columns.min()) - 4, 0),
            max(int(rows.min()) - 4, 0),
            min(int(columns.max()) + 6, self.width_px),
            min(int(rows.max()) + 6, self.height_px),
        )

    def brought_home(self, ideal: Array, box: tuple[int, int, int, int], fine: tuple[int, int, int, int]) -> Array:
        """The real picture in a box, from the ideal one in its box."""
        if self.places is None:
            return ideal
        room = _room(self.blur_px)
        window = _fine(box, room, self.places.shape)
        places = self.places[:, *window] - np.array([fine[1], fine[0]])[:, None, None]
        bent = map_coordinates(ideal, places, order=3, mode="nearest")
        soft = cv2.GaussianBlur(bent, (0, 0), self.blur_px, borderType=cv2.BORDER_REPLICATE)
        top, left = box[1] * FINER - window[0].start, box[0] * FINER - window[1].start
        height, width = box[3] - box[1], box[2] - box[0]
        own = soft[top : top + height * FINER, left : left + width * FINER]
        return np.asarray(own.reshape(height, FINER, width, FINER).mean((1, 3)))


def _room(blur_px: float) -> int:
    """Fine pixels that a blur needs on every side."""
    return FINER * int(np.ceil(4.0 * blur_px / FINER))


def _fine(box: tuple[int, int, int, int], room: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of the fine picture about a box of the real one, with room for the blur."""
    return (
        slice(max(box[1] * FINER - room, 0), min(box[3] * FINER + room, shape[1])),
        slice(max(box[0] * FINER - room, 0), min(box[2] * FINER + room, shape[2])),
    )


def _optics(camera: Camera, blur_px: float) -> _Optics:
    """The ideal camera behind a real one."""
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    pose[:3, 3] = camera.centre_m
    K = camera.matrix
    if K[0, 0] == K[1, 1] and K[0, 1] == 0 and not camera.distortion.any():
        middle = (float(K[0, 2]), float(K[1, 2]))
        return _Optics(camera.width_px, camera.height_px, float(K[0, 0]), middle, blur_px, pose)
    directions = _undistorted(camera)
    focal = FINER * float(max(K[0, 0], K[1, 1]))
    low, high = focal * directions.min((0, 1)), focal * directions.max((0, 1))
    middle_px = -np.floor(low) + 8.0
    width, height = (np.ceil(high + middle_px) + 9.0).astype(int)
    places = np.stack([focal * directions[..., 1] + middle_px[1], focal * directions[..., 0] + middle_px[0]])
    # Variances add: the fine filter, the mean over FINER points a pixel, and the rest as a blur of the fine picture.
    rest = (FINER * blur_px) ** 2 - FINE_FILTER_PX**2 - (FINER**2 - 1) / 12.0
    centre = (float(middle_px[0]), float(middle_px[1]))
    return _Optics(int(width), int(height), focal, centre, FINE_FILTER_PX, pose, places, float(np.sqrt(rest)))


def _undistorted(camera: Camera) -> Array:
    """(rows, columns, 2) x/z and y/z, seen without distortion, of FINER × FINER points in every pixel."""
    x = (np.arange(camera.width_px * FINER) + 0.5) / FINER - 0.5
    y = (np.arange(camera.height_px * FINER) + 0.5) / FINER - 0.5
    K, (k1, k2, p1, p2, k3) = camera.matrix, camera.distortion
    px, py = np.meshgrid(x, y)
    seen_y = (py - K[1, 2]) / K[1, 1]
    seen_x = (px - K[0, 2] - K[0, 1] * seen_y) / K[0, 0]
    free_x, free_y = seen_x, seen_y
    for _ in range(MOST_TURNS):
        r2 = free_x**2 + free_y**2
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        next_x = (seen_x - 2.0 * p1 * free_x * free_y - p2 * (r2 + 2.0 * free_x**2)) / radial
        next_y = (seen_y - p1 * (r2 + 2.0 * free_y**2) - 2.0 * p2 * free_x * free_y) / radial
        step_px = K[0, 0] * max(float(np.abs(next_x - free_x).max()), float(np.abs(next_y - free_y).max()))
        free_x, free_y = next_x, next_y
        if step_px < 1e-6:
            return np.asarray(np.stack([free_x, free_y], -1))
    raise ValueError(
        f"distortion = {camera.distortion.tolist()}: the lens folds the picture over within the frame; "
        "wanted a distortion that every pixel can be traced back through"
    )


# --- Mitsuba ---


def _mitsuba(effort: Effort) -> Any:
    """The renderer's module. Raises NoRendererError where it is not installed."""
    try:
        import drjit
        import mitsuba
    except ImportError as error:
        raise NoRendererError(
            "films are rendered with Mitsuba 3, which is not installed; try pip install 'diethrow[film]'"
        ) from error
    if effort.variant not in mitsuba.variants():
        raise ValueError(f"variant = {effort.variant!r}: wanted one of {', '.join(mitsuba.variants())}")
    mitsuba.set_variant(effort.variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # the sampler rounds its counts up, and would say so on every frame
    drjit.set_thread_count(effort.threads)
    return mitsuba


def _scene(mi: Any, die: Die, optics: _Optics, surface: str, look: Look) -> dict[str, Any]:
    """Everything, as Mitsuba's dictionary."""
    paint = face_paint(die, paint=look.paint, ink=look.ink, grain=look.grain, seed=look.seed)
    coat = mi.load_dict({"type": "roughplastic", "alpha": look.roughness, "diffuse_reflectance": _picture(mi, paint)})
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH},
        "sensor": _sensor(mi, optics),
        "table": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(TABLE_HALF_M),
            "bsdf": _table_coat(mi, surface, look),
        },
        "lamp": _lamp(mi, look.lamp_m, look.lamp_side_m),
        "room": _room_light(mi, surface, look),
        "body": {"type": "shapegroup", "skin": _mesh(mi, die_mesh(die), coat)},
        "die": {"type": "instance", "to_world": mi.ScalarTransform4f(), "of": {"type": "ref", "id": "body"}},
    }
    for k, rod in enumerate(look.rods_m):
        scene[f"rod_{k}"] = _rod(*rod)
    if is_mirror(surface):
        mesh = die_mesh(die)
        flipped = Mesh(mesh.vertices_m * UPSIDE_DOWN, mesh.normals * UPSIDE_DOWN, mesh.places, mesh.triangles[:, ::-1])
        x, y, z = look.lamp_m
        scene["integrator"] = {"type": "volpath", "max_depth": DEPTH}
        scene["image_lamp"] = _lamp(mi, (x, y, -z), look.lamp_side_m)
        scene["image_body"] = {"type": "shapegroup", "skin": _mesh(mi, flipped, coat)}
        scene["image"] = {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(),
            "of": {"type": "ref", "id": "image_body"},
        }
        for k, (begin, end, radius) in enumerate(look.rods_m):
            down = tuple(np.array(begin) * UPSIDE_DOWN), tuple(np.array(end) * UPSIDE_DOWN)
            scene[f"image_rod_{k}"] = _rod(*down, radius)
    return scene


def _rod(begin: Point, end: Point, radius: float) -> dict[str, Any]:
    coat = {"type": "twosided", "coat": {"type": "diffuse", "reflectance": _grey(0.2)}}
    return {"type": "cylinder", "p0": list(begin), "p1": list(end), "radius": radius, "bsdf": coat}


def _sensor(mi: Any, optics: _Optics) -> dict[str, Any]:
    width, height = optics.width_px, optics.height_px
    return {
        "type": "perspective",
        "fov": float(np.degrees(2.0 * np.arctan(width / 2.0 / optics.focal_px))),
        "fov_axis": "x",
        # Mitsuba's offsets are parts of the picture, to the left and up, from its middle; its pixel centres are at 0.5.
        "principal_point_offset_x": 0.5 - (optics.middle_px[0] + 0.5) / width,
        "principal_point_offset_y": 0.5 - (optics.middle_px[1] + 0.5) / height,
        "to_world": mi.ScalarTransform4f(optics.pose),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "luminance",
            "rfilter": {"type": "gaussian", "stddev": optics.filter_px},
        },
        "sampler": {"type": "multijitter"},
    }


def _lamp(mi: Any, middle: Point, side: float) -> dict[str, Any]:
    """A square that faces the origin and lights it with irradiance 1."""
    place = mi.ScalarTransform4f().look_at(origin=list(middle), target=[0, 0, 0], up=[0, 0, 1])
    return {
        "type": "rectangle",
        "to_world": place @ mi.ScalarTransform4f().scale(side / 2),
        "emitter": {"type": "area", "radiance": _grey(float(np.linalg.norm(middle)) ** 2 / side**2)},
    }


def _room_light(mi: Any, surface: str, look: Look) -> dict[str, Any]:
    """Even light from all sides; round a mirror, which shows it, a room with things in it."""
    radiance = look.fill / np.pi
    if not is_mirror(surface):
        return {"type": "constant", "radiance": _grey(radiance)}
    rng = np.random.default_rng(look.seed + 1)
    above = np.full((256, 1024), 0.4, np.float32)  # three pixels a degree, zenith to horizon
    for _ in range(500):
        row, column = rng.integers(0, 256), rng.integers(0, 1024)
        high, wide = rng.integers(6, 40, 2)
        above[row : row + high, column : column + wide] = rng.choice([0.15, 0.4, 1.0, 2.0])
    above = cv2.GaussianBlur(above, (0, 0), 2.0)  # out of focus
    room = np.concatenate([above, above[::-1]]) * (radiance / above.mean())
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(np.repeat(room[..., None], 3, 2), np.float32)),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90.0),
    }


def _table_coat(mi: Any, surface: str, look: Look) -> dict[str, Any]:
    scale = mi.ScalarTransform4f().scale(2.0 * TABLE_HALF_M / WIDTH_M)
    shift = mi.ScalarTransform4f().translate([0.5, 0.5, 0.0])
    # The rectangle's own coordinates run from 0 to 1; the texture's middle is to lie at the origin.
    to_uv = shift @ scale @ mi.ScalarTransform4f().translate([-0.5, -0.5, 0.0])
    paint = table_paint(surface, look.seed)
    if is_mirror(surface):
        film = _picture(mi, np.asarray(1.0 - REFLECTANCE * (1.0 - paint), np.float32), to_uv)
        return {"type": "mask", "opacity": film, "dust": {"type": "diffuse", "reflectance": _picture(mi, paint, to_uv)}}
    paint = np.asarray(np.clip(look.table_tone * paint, 0.0, 0.95), np.float32)
    if "cork" in surface.lower():
        return {"type": "diffuse", "reflectance": _picture(mi, paint, to_uv)}
    return {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": _picture(mi, paint, to_uv)}


def _picture(mi: Any, levels: NDArray[np.float32], to_uv: Any = None) -> dict[str, Any]:
    texture = {"type": "bitmap", "data": mi.TensorXf(np.ascontiguousarray(levels[..., None])), "raw": True}
    return texture | ({"to_uv": to_uv} if to_uv is not None else {})


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": float(value)}


def _mesh(mi: Any, mesh: Mesh, coat: Any) -> Any:
    properties = mi.Properties()
    properties["mesh_bsdf"] = coat
    shape = mi.Mesh(
        "skin",
        len(mesh.vertices_m),
        len(mesh.triangles),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    handles = mi.traverse(shape)
    for name, values in (
        ("vertex_positions", mesh.vertices_m),
        ("vertex_normals", mesh.normals),
        ("vertex_texcoords", mesh.places),
        ("faces", mesh.triangles),
    ):
        kind = np.uint32 if name == "faces" else np.float32
        handles[name] = type(handles[name])(np.ascontiguousarray(values, kind).ravel())
    handles.update()
    return shape
