"""A camera's view of a throw, path-traced with Mitsuba 3 (Jakob et al., 2022).

The scene (`mitsuba_scene`) has the die with marks, rounded corners and glossy paint; a textured or reflecting table; a
lamp of finite size, whose shadows have soft borders; and the dim light of a room. Contact shadows, mirror images and glare
follow from it. The camera is the calibrated one, with lens distortion (`lens`).

**Exposure.** A frame is the mean over the instants of its shutter (`shutter`), for each row with that row's shares.

**Depth of field.** With an aperture every instant is seen through another point of it (`lens`); the mean over all points blurs
each point of the scene by its own distance from the plane of focus.

**Cost.** The empty table is rendered once, with more light paths. In every frame only a box around the die (and its mirror
image) is rendered, and blended into the empty table over `FEATHER_PX`. Where the die only shades the table, the empty table
is multiplied by the ratio of two coarse images, with and without the die.

No physics is computed here: the poses are those of the given `Throw`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.errors import InputError
from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ...tracking.camera import Camera
from .image_boxes import BOX_STEP_PX, Box, blend, box_about, merged, part_of, rounded_up
from .lens import FINER, MAX_POINTS, PINHOLE, Aperture, optics_of
from .mitsuba_scene import MIRRORED_Z, Appearance, scene_of, sensor_axes
from .shutter import MAX_CELLS, Shutter, instants_of
from .table_textures import is_mirror

Array = NDArray[np.float64]

EMPTY_TABLE_FACTOR = 4
"""Light paths per pixel of the empty table, as a multiple of those of a frame."""
MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0])
"""(4, 4) maps a point to its image in the table."""
CHUNK_PX_SAMPLES = 40_000_000
"""Samples that Mitsuba computes at once: they take 2 GB in its vectorised variants."""
OUT_OF_VIEW_M = np.array([0.0, -50.0, 50.0])
"""Position of the die for images of the empty table."""
SHADE_SAMPLES = 4
"""Light paths per pixel that is only shaded."""
ROLLING_SHADE_INSTANTS = 12
"""Instants of the shade of a rolling shutter, each for the rows nearest to it."""
SHADE_BLUR_PX = 1.5
"""Blur of the shade: a lamp of finite size casts no sharper one."""
MAX_SHADE = 1.15
"""Largest ratio of light with and without the die. A die reflects less onto the table; more is a single unlikely path."""
FIREFLY_PX, FIREFLY_FACTOR, FIREFLY_LIGHT = 5, 1.6, 0.05
"""Width of a neighbourhood, and factor and light by which a pixel that a single path made bright exceeds its median."""
SILHOUETTE_MARGIN_PX = 3
"""Margin of the outline of a die within which no pixel is replaced: five standard deviations of the usual lens blur."""
PATH_POINTS = 9
"""Instants between which the way of the corners during a frame is measured: a readout may hold an impact."""
AXIS = np.zeros(2)
"""The middle of the aperture."""
MIN_BLUR_PX = 0.4
"""Smallest point spread: the area of a pixel alone has a standard deviation of 0.3 px."""


class NoRendererError(InputError):
    """Mitsuba is not installed; the extra `film` includes it."""


@dataclass(frozen=True)
class RenderSettings:
    """The quality and the resources of rendering."""

    samples: int = 48
    """Light paths per pixel of a frame. Their noise must stay below that of the sensor."""
    threads: int = 1
    variant: str = "scalar_rgb"
    """Variant of Mitsuba. `llvm_ad_mono` is three times as fast, and needs LLVM 19 or newer."""

    def __post_init__(self) -> None:
        if self.samples < 1 or self.threads < 1:
            raise InputError(f"samples = {self.samples}, threads = {self.threads}: wanted 1 or more of each")


def frame_light(
    renderer: FilmRenderer, throws: Throw | Sequence[Throw], times_s: Array, shutter: Shutter | float
) -> Iterator[Array]:
    """The light (height, width) on each frame, 1.0 where it saturates the sensor; `times_s` (n,) are mid-exposures.

    `throws` has a throw for every die of the renderer. A shutter that is a number is the exposure of a global one [s].
    """
    throws = (throws,) if isinstance(throws, Throw) else tuple(throws)
    shutter = shutter if isinstance(shutter, Shutter) else Shutter(shutter)
    for number, time_s in enumerate(times_s):
        yield renderer.light(exposure_of(renderer, throws, float(time_s), shutter), seed=number)


def exposure_of(renderer: FilmRenderer, throws: Sequence[Throw], time_s: float, shutter: Shutter) -> Exposure:
    """The poses of all dice during the exposure of a frame."""
    spread = shutter.span_s * np.linspace(-0.5, 0.5, PATH_POINTS)
    corners = renderer.corners_px(*_poses(throws, time_s + spread))
    path = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(1).sum()
    moved_px = float(path) if np.isfinite(path) else 0.0
    fewest = renderer.aperture_points(*_poses(throws, np.array([time_s])))
    instants = instants_of(time_s, shutter, renderer.camera.height_px, moved_px, fewest)
    return Exposure(*_poses(throws, instants.times_s), instants.row_shares)


def _poses(throws: Sequence[Throw], times_s: Array) -> tuple[Array, Array]:
    """Positions (m, dice, 3) and quaternions (m, dice, 4)."""
    each = [throw.poses(times_s) for throw in throws]
    return np.stack([position for position, _ in each], 1), np.stack([quaternion for _, quaternion in each], 1)


@dataclass(frozen=True, eq=False)
class Exposure:
    """The dice during one exposure."""

    positions_m: Array
    """(m, dice, 3)."""
    quaternions: Array
    """(m, dice, 4)."""
    row_shares: Array | None = None
    """(rows, m) as in `Instants`; None if every row sees all instants equally."""


class FilmRenderer:
    """The scene in Mitsuba, which renders the die at any pose. It has state: the pose of its one die changes."""

    def __init__(
        self,
        die: Die,
        camera: Camera,
        surface: str,
        appearance: Appearance,
        *,
        blur_px: float = 0.6,
        aperture: Aperture = PINHOLE,
        dice: int = 1,
        rendering: RenderSettings = RenderSettings(),
    ) -> None:
        """Raises NoRendererError without Mitsuba, ValueError for a blur below MIN_BLUR_PX."""
        if blur_px < MIN_BLUR_PX:
            raise InputError(f"blur_px = {blur_px}: wanted {MIN_BLUR_PX} or more; the area of a pixel alone gives 0.3")
        self.die, self.camera, self.appearance, self.rendering = die, camera, appearance, rendering
        self.aperture = aperture
        self._mirror = is_mirror(surface)
        self._optics = optics_of(camera, blur_px)
        self._mi = _mitsuba(rendering)
        self._scene = self._mi.load_dict(scene_of(self._mi, die, self._optics, surface, appearance, dice))
        self._handles = self._mi.traverse(self._scene)
        self._gain = appearance.lit_face_level * np.pi / (appearance.die_reflectance * (1.0 + appearance.room_light))
        self._away = np.tile(OUT_OF_VIEW_M, (dice, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (dice, 1))
        self._empty: Array | None = None

    def corners_px(self, positions_m: Array, quaternions: Array) -> Array:
        """Image positions (m, corners, 2) of the corners of the sharp dice at poses (m, dice, 3), (m, dice, 4)."""
        return self.camera.project(self._corners(positions_m, quaternions).reshape(len(positions_m), -1, 3))

    def _corners(self, positions_m: Array, quaternions: Array) -> Array:
        """(m, dice, corners, 3) in the world."""
        rotations = matrix_from_quat(quaternions.reshape(-1, 4)).reshape(*quaternions.shape[:2], 3, 3)
        return np.asarray(self.die.solid.vertices @ np.swapaxes(rotations, 2, 3) + positions_m[:, :, None])

    def aperture_points(self, positions_m: Array, quaternions: Array) -> int:
        """Points of the aperture that are needed to see the dice at these poses without steps in their blur."""
        return self.aperture.points(self.camera, self._corners(positions_m, quaternions).reshape(-1, 3))

    def empty(self) -> Array:
        """The light (height, width) on an image of the table without the dice."""
        if self._empty is None:
            self._place(*self._away)
            whole = (0, 0, self.camera.width_px, self.camera.height_px)
            points = self.aperture.offsets_m(MAX_POINTS) if self.aperture.diameter_m > 0 else np.zeros((1, 2))
            samples = max(1, EMPTY_TABLE_FACTOR * self.rendering.samples // len(points))
            images = (self._render(whole, samples, seed=2**31 + k, eye_m=point) for k, point in enumerate(points))
            self._empty = np.asarray(sum(images) / len(points))
        return self._empty

    def light(self, exposure: Exposure, *, seed: int) -> Array:
        """The light (height, width) of an exposure."""
        image = self.empty().copy()
        near, shaded = self._boxes(exposure)
        for box in shaded:
            blend(image, self._shade(box, exposure, seed) * image[part_of(box)], box)
        for box in near:
            inside = self._inside(box, exposure, seed)
            if not self._mirror:  # which shows highlights beside the dice
                clear = self.appearance.translucency > 0  # single paths also leave the die itself
                kept = np.zeros(inside.shape, bool) if clear else self._silhouettes(box, exposure)
                inside = _without_fireflies(inside, self.empty()[part_of(box)], kept)
            blend(image, inside, box)
        return image

    def _inside(self, box: Box, exposure: Exposure, seed: int) -> Array:
        """The light in a box: the mean over the instants, each rendered on the rows that see it."""
        count = len(exposure.positions_m)
        eyes_m = self.aperture.offsets_m(count)
        inside = np.zeros((box[3] - box[1], box[2] - box[0]))
        shares = np.full((len(inside), count), 1.0 / count)
        if exposure.row_shares is not None:
            shares = exposure.row_shares[box[1] : box[3]]
        samples = max(1, round(self.rendering.samples * float(shares.max())))
        for k, own in self._strips(box, shares):
            self._place(exposure.positions_m[k], exposure.quaternions[k])
            light = self._rows(box, own, samples, seed=seed * MAX_CELLS + k, eye_m=eyes_m[k])
            inside[own] += shares[own, k, None] * light
        return inside

    def _strips(self, box: Box, shares: Array) -> Iterator[tuple[int, slice]]:
        """For every instant that is seen in a box, its number and the rows of the box that are rendered for it."""
        height = box[3] - box[1]
        for k in range(shares.shape[1]):
            rows = np.flatnonzero(shares[:, k])
            if len(rows):
                size = min(-(-(int(rows[-1] - rows[0]) + 1) // BOX_STEP_PX) * BOX_STEP_PX, height)
                top = min(int(rows[0]), height - size)
                yield k, slice(top, top + size)

    def _rows(self, box: Box, own: slice, samples: int, *, seed: int, eye_m: Array = AXIS) -> Array:
        """The light in some rows of a box."""
        return self._render((box[0], box[1] + own.start, box[2], box[1] + own.stop), samples, seed=seed, eye_m=eye_m)

    def _shade(self, box: Box, exposure: Exposure, seed: int) -> Array:
        """Ratio of the light in a box with the dice to that without them, along the same light paths.

        The texture and most of the noise are common to both images and cancel; the smooth rest is blurred.
        """
        count = len(exposure.positions_m)
        most = SHADE_SAMPLES if exposure.row_shares is None else ROLLING_SHADE_INSTANTS
        chosen = np.unique(np.linspace(0, count - 1, most).round().astype(int))
        nearest = np.abs(np.arange(count)[:, None] - chosen).argmin(1)
        shares = np.full((box[3] - box[1], len(chosen)), 1.0 / len(chosen))
        if exposure.row_shares is not None:
            rows = exposure.row_shares[box[1] : box[3]]
            shares = np.stack([rows[:, nearest == j].sum(1) for j in range(len(chosen))], 1)
        samples = max(1, round(SHADE_SAMPLES * float(shares.max())))
        total = np.zeros((2, box[3] - box[1], box[2] - box[0]))
        for j, own in self._strips(box, shares):
            k = int(chosen[j])
            placed = (exposure.positions_m[k], exposure.quaternions[k]), self._away
            for row, (positions, quaternions) in enumerate(placed):
                self._place(positions, quaternions)
                light = self._rows(box, own, samples, seed=seed * MAX_CELLS + k)
                total[row, own] += shares[own, j, None] * light
        total[0] = np.minimum(total[0], MAX_SHADE * total[1])
        with_die, without = (cv2.GaussianBlur(part, (0, 0), SHADE_BLUR_PX) for part in total)
        return np.asarray(with_die / np.maximum(without, 1e-9))

    def _silhouettes(self, box: Box, exposure: Exposure) -> NDArray[np.bool_]:
        """Pixels of a box that dice may cover during the exposure."""
        covered = np.zeros((box[3] - box[1], box[2] - box[0]), np.uint8)
        for k in range(exposure.positions_m.shape[1]):
            part = slice(k, k + 1)
            corners = self._corners(exposure.positions_m[:, part], exposure.quaternions[:, part]).reshape(-1, 3)
            seen = self.camera.project(corners) - np.array(box[:2])
            if np.isfinite(seen).all():
                outline = cv2.convexHull(np.rint(seen).astype(np.int32))
                cv2.fillConvexPoly(covered, outline, 1)
                # The hull grows by the defocus and by the lens blur on each side.
                grown = int(np.ceil(self.aperture.blur_px(self.camera, corners) / 2)) + SILHOUETTE_MARGIN_PX
                cv2.polylines(covered, [outline], True, 1, 2 * grown + 1)
        return covered > 0

    def _place(self, positions_m: Array, quaternions: Array) -> None:
        """Move all dice, (dice, 3) and (dice, 4)."""
        for k, (position, rotation) in enumerate(zip(positions_m, matrix_from_quat(quaternions), strict=True)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, position
            self._handles[f"die_{k}.to_world"] = self._mi.Transform4f(pose)
            if self._mirror:
                self._handles[f"image_{k}.to_world"] = self._mi.Transform4f(MIRRORED @ pose @ MIRRORED)
        self._handles.update()

    def _render(self, box: Box, samples: int, *, seed: int, eye_m: Array = AXIS) -> Array:
        """The light in a box (left, top, right, bottom) of the real image, seen from a point (2,) of the aperture."""
        fine = self._optics.rendered_box(box)
        self._aim(fine, eye_m)
        samples = max(1, samples // (FINER**2 if self._optics.source_px is not None else 1))
        at_once = max(1, CHUNK_PX_SAMPLES // ((fine[2] - fine[0]) * (fine[3] - fine[1])))
        passes = int(np.ceil(samples / at_once))
        total = np.zeros((fine[3] - fine[1], fine[2] - fine[0]))
        for k in range(passes):
            rendered = self._mi.render(self._scene, spp=int(np.ceil(samples / passes)), seed=(seed * 64 + k) % 2**32)
            total += np.asarray(rendered, float)[..., 0] / passes
        return self._gain * self._optics.to_real_image(total, box, fine)

    def _aim(self, fine: Box, eye_m: Array) -> None:
        """Let the camera show this box of the ideal image alone, by another principal point, from a point of the aperture.

        A crop of the whole image is slower: its position is a constant of Mitsuba's compiled code, which would be compiled
        again for every frame (0.3 s).
        """
        size = [fine[2] - fine[0], fine[3] - fine[1]]
        for name in ("size", "crop_size"):
            self._handles[f"sensor.film.{name}"] = size
        optics = self._optics
        if self.aperture.diameter_m > 0:
            optics = self.aperture.seen_from(optics, eye_m)
            self._handles["sensor.to_world"] = self._mi.Transform4f(optics.pose)
        for name, value in sensor_axes(optics, fine).items():
            self._handles[f"sensor.{name}"] = value
        self._handles.update()

    def _boxes(self, exposure: Exposure) -> tuple[list[Box], ...]:
        """Boxes around the dice and, on a mirror, their images; and boxes around the table that they shade."""
        near, shaded = [], []
        for k in range(exposure.positions_m.shape[1]):
            positions = exposure.positions_m[:, k]
            corners = self._corners(exposure.positions_m[:, k : k + 1], exposure.quaternions[:, k : k + 1])
            corners = corners.reshape(-1, 3)
            margin = self.aperture.blur_px(self.camera, corners) / 2
            near.append(self._box(corners, margin))
            if self._mirror:
                near.append(self._box(corners * MIRRORED_Z, self.aperture.blur_px(self.camera, corners * MIRRORED_Z)))
            shaded.append(self._box(self._shaded(corners, positions), margin))
        return tuple(
            merged([rounded_up(box, self.camera, step_px) for box in merged([box for box in boxes if box is not None])])
            for boxes, step_px in ((near, BOX_STEP_PX), (shaded, 2 * BOX_STEP_PX))
        )

    def _box(self, points_m: Array, margin_px: float) -> Box | None:
        """The box around points of the world, with a margin for their blur."""
        seen = self.camera.project(points_m)
        return box_about(np.concatenate([seen - margin_px, seen + margin_px]), self.camera)

    def _shaded(self, corners_m: Array, positions_m: Array) -> Array:
        """Points around the shaded part of the table: the lamp's shadow, and the contact shadow below the die."""
        half = self.appearance.lamp_side_m / 2 * np.sqrt(2.0)
        lamp = np.array(self.appearance.lamp_m)
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


def _without_fireflies(light: Array, empty: Array, kept: NDArray[np.bool_]) -> Array:
    """Replace isolated bright pixels by the shade around them, except where dice may be.

    They are single paths from the lamp over a glossy or transparent die to the table. The smooth light of all such paths would
    need a thousand times the samples. The shade is the median ratio to the empty table, whose texture may have bright specks.
    """
    ratio = light / np.maximum(empty, 1e-6)
    around = cv2.medianBlur(ratio.astype(np.float32), FIREFLY_PX)
    found = (ratio > FIREFLY_FACTOR * around) & (light > around * empty + FIREFLY_LIGHT) & ~kept
    wide = cv2.dilate(found.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return np.where(wide & ~kept, around * empty, light)


def _mitsuba(rendering: RenderSettings) -> Any:
    """The module of the renderer. Raises NoRendererError if it is not installed, ValueError for an unknown variant."""
    try:
        import drjit
        import mitsuba
    except ImportError as error:
        raise NoRendererError(
            "Mitsuba 3, which renders films, is not installed; run pip install 'diethrow[film]'"
        ) from error
    if rendering.variant not in mitsuba.variants():
        raise InputError(f"variant = {rendering.variant!r}: wanted one of {', '.join(mitsuba.variants())}")
    mitsuba.set_variant(rendering.variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # otherwise the sampler warns of rounded counts on every frame
    drjit.set_thread_count(rendering.threads)
    return mitsuba
