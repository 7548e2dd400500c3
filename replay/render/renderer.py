"""A camera's view of a throw, path-traced with Mitsuba 3 (Jakob et al., 2022).

The scene (`mitsuba_scene`) has the die with marks, rounded corners and glossy paint; a textured or reflecting table; a
lamp of finite size, whose shadows have soft borders; and the dim light of a room. Contact shadows, mirror images and glare
follow from it. The camera is the calibrated one, with lens distortion (`lens`).

**Exposure.** A frame is the mean over instants spread evenly over the exposure, so many that no corner moves more than
`MAX_STEP_PX` between two of them. This gives the true motion blur, also across an impact.

**Cost.** The empty table is rendered once, with more light paths. In every frame only a box around the die (and its mirror
image) is rendered, and blended into the empty table over `FEATHER_PX`. Where the die only shades the table, the empty table
is multiplied by the ratio of two coarse images, with and without the die.

No physics is computed here: the poses are those of the given `Throw`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ...tracking.camera import Camera
from .image_boxes import BOX_STEP_PX, Box, blend, box_about, merged, part_of, rounded_up
from .lens import FINER, optics_of
from .mitsuba_scene import MIRRORED_Z, Appearance, scene_of, sensor_axes
from .table_textures import is_mirror

Array = NDArray[np.float64]

MAX_STEP_PX = 0.4
"""Largest step of a corner between two instants of an exposure: below the lens blur, so that the steps are invisible."""
MAX_INSTANTS = 24
"""Instants of an exposure. Motion blur beyond 10 px shows steps, but such footage cannot be tracked anyway."""
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
SHADE_BLUR_PX = 1.5
"""Blur of the shade: a lamp of finite size casts no sharper one."""
MAX_SHADE = 1.15
"""Largest ratio of light with and without the die. A die reflects less onto the table; more is a single unlikely path."""
MIN_BLUR_PX = 0.4
"""Smallest point spread: the area of a pixel alone has a standard deviation of 0.3 px."""


class NoRendererError(ValueError):
    """Mitsuba is not installed; the extra `film` includes it."""


@dataclass(frozen=True)
class RenderSettings:
    """The quality and the resources of rendering."""

    samples: int = 48
    """Light paths per pixel of a frame. Their noise must stay below that of the sensor."""
    threads: int = 1
    variant: str = "scalar_rgb"
    """Variant of Mitsuba. `llvm_ad_mono` is twice as fast, and needs a recent LLVM library."""

    def __post_init__(self) -> None:
        if self.samples < 1 or self.threads < 1:
            raise ValueError(f"samples = {self.samples}, threads = {self.threads}: wanted 1 or more of each")


def frame_light(renderer: FilmRenderer, throw: Throw, times_s: Array, exposure_s: float) -> Iterator[Array]:
    """The light (height, width) on each frame, 1.0 where it saturates the sensor; `times_s` (n,) are mid-exposures."""
    for number, time_s in enumerate(times_s):
        yield renderer.light(*_poses(renderer, throw, float(time_s), exposure_s), seed=number)


def _poses(renderer: FilmRenderer, throw: Throw, time_s: float, exposure_s: float) -> tuple[Array, Array]:
    """Positions (m, 3) and quaternions (m, 4) during an exposure; no corner moves more than MAX_STEP_PX between two."""
    ends = throw.poses(time_s + exposure_s * np.array([-0.5, 0.0, 0.5]))
    corners = renderer.corners_px(*ends)
    path = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(1).sum()
    count = int(np.clip(np.ceil(path / MAX_STEP_PX), 1, MAX_INSTANTS)) if np.isfinite(path) else 1
    share = (np.arange(count) + 0.5) / count - 0.5
    return throw.poses(time_s + exposure_s * share)


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
        rendering: RenderSettings = RenderSettings(),
    ) -> None:
        """Raises NoRendererError without Mitsuba, ValueError for a blur below MIN_BLUR_PX."""
        if blur_px < MIN_BLUR_PX:
            raise ValueError(f"blur_px = {blur_px}: wanted {MIN_BLUR_PX} or more; the area of a pixel alone gives 0.3")
        self.die, self.camera, self.appearance, self.rendering = die, camera, appearance, rendering
        self._mirror = is_mirror(surface)
        self._optics = optics_of(camera, blur_px)
        self._mi = _mitsuba(rendering)
        self._scene = self._mi.load_dict(scene_of(self._mi, die, self._optics, surface, appearance))
        self._handles = self._mi.traverse(self._scene)
        self._gain = appearance.lit_face_level * np.pi / (appearance.die_reflectance * (1.0 + appearance.room_light))
        self._empty: Array | None = None

    def corners_px(self, positions_m: Array, quaternions: Array) -> Array:
        """Image positions (m, corners, 2) of the corners of the sharp die."""
        corners = self.die.solid.vertices @ matrix_from_quat(quaternions).transpose(0, 2, 1) + positions_m[:, None]
        return self.camera.project(corners)

    def empty(self) -> Array:
        """The light (height, width) on an image of the table without the die."""
        if self._empty is None:
            self._place(OUT_OF_VIEW_M, np.array([1.0, 0.0, 0.0, 0.0]))
            whole = (0, 0, self.camera.width_px, self.camera.height_px)
            self._empty = self._render(whole, EMPTY_TABLE_FACTOR * self.rendering.samples, seed=2**31)
        return self._empty

    def light(self, positions_m: Array, quaternions: Array, *, seed: int) -> Array:
        """The light (height, width) of an exposure over poses (m, 3), (m, 4), each for an equal part of it."""
        image = self.empty().copy()
        near, shaded = self._boxes(positions_m, quaternions)
        for box in shaded:
            blend(image, self._shade(box, positions_m, quaternions, seed) * image[part_of(box)], box)
        samples = max(1, round(self.rendering.samples / len(positions_m)))
        for box in near:
            inside = np.zeros((box[3] - box[1], box[2] - box[0]))
            for k, (position, quaternion) in enumerate(zip(positions_m, quaternions, strict=True)):
                self._place(position, quaternion)
                inside += self._render(box, samples, seed=seed * MAX_INSTANTS + k) / len(positions_m)
            blend(image, inside, box)
        return image

    def _shade(self, box: Box, positions_m: Array, quaternions: Array, seed: int) -> Array:
        """Ratio of the light in a box with the die to that without it, along the same light paths.

        The texture and most of the noise are common to both images and cancel; the smooth rest is blurred.
        """
        chosen = np.unique(np.linspace(0, len(positions_m) - 1, SHADE_SAMPLES).round().astype(int))
        samples = max(1, SHADE_SAMPLES // len(chosen))
        total = np.zeros((2, box[3] - box[1], box[2] - box[0]))
        for k in chosen:
            for row, position in enumerate((positions_m[k], OUT_OF_VIEW_M)):
                self._place(position, quaternions[k])
                total[row] += self._render(box, samples, seed=seed * MAX_INSTANTS + int(k))
        total[0] = np.minimum(total[0], MAX_SHADE * total[1])
        with_die, without = (cv2.GaussianBlur(part, (0, 0), SHADE_BLUR_PX) for part in total)
        return np.asarray(with_die / np.maximum(without, 1e-9))

    def _place(self, position_m: Array, quaternion: Array) -> None:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = matrix_from_quat(quaternion), position_m
        self._handles["die.to_world"] = self._mi.Transform4f(pose)
        if self._mirror:
            self._handles["image.to_world"] = self._mi.Transform4f(MIRRORED @ pose @ MIRRORED)
        self._handles.update()

    def _render(self, box: Box, samples: int, *, seed: int) -> Array:
        """The light in a box (left, top, right, bottom) of the real image."""
        fine = self._optics.rendered_box(box)
        self._aim(fine)
        samples = max(1, samples // (FINER**2 if self._optics.source_px is not None else 1))
        at_once = max(1, CHUNK_PX_SAMPLES // ((fine[2] - fine[0]) * (fine[3] - fine[1])))
        passes = int(np.ceil(samples / at_once))
        total = np.zeros((fine[3] - fine[1], fine[2] - fine[0]))
        for k in range(passes):
            rendered = self._mi.render(self._scene, spp=int(np.ceil(samples / passes)), seed=(seed * 64 + k) % 2**32)
            total += np.asarray(rendered, float)[..., 0] / passes
        return self._gain * self._optics.to_real_image(total, box, fine)

    def _aim(self, fine: Box) -> None:
        """Let the camera show this box of the ideal image alone, by another principal point.

        A crop of the whole image is slower: its position is a constant of Mitsuba's compiled code, which would be compiled
        again for every frame (0.3 s).
        """
        size = [fine[2] - fine[0], fine[3] - fine[1]]
        for name in ("size", "crop_size"):
            self._handles[f"sensor.film.{name}"] = size
        for name, value in sensor_axes(self._optics, fine).items():
            self._handles[f"sensor.{name}"] = value
        self._handles.update()

    def _boxes(self, positions_m: Array, quaternions: Array) -> tuple[list[Box], list[Box]]:
        """Boxes around the die and, on a mirror, its image; and boxes around the table that the die shades."""
        corners = (
            self.die.solid.vertices @ matrix_from_quat(quaternions).transpose(0, 2, 1) + positions_m[:, None]
        ).reshape(-1, 3)
        near = [corners, corners * MIRRORED_Z] if self._mirror else [corners]
        shaded = [self._shaded(corners, positions_m)]
        boxes = [[box_about(self.camera.project(points), self.camera) for points in group] for group in (near, shaded)]
        near_boxes, shaded_boxes = ([box for box in group if box is not None] for group in boxes)
        return (
            [rounded_up(box, self.camera, BOX_STEP_PX) for box in merged(near_boxes)],
            [rounded_up(box, self.camera, 2 * BOX_STEP_PX) for box in shaded_boxes],
        )

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
        raise ValueError(f"variant = {rendering.variant!r}: wanted one of {', '.join(mitsuba.variants())}")
    mitsuba.set_variant(rendering.variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)  # otherwise the sampler warns of rounded counts on every frame
    drjit.set_thread_count(rendering.threads)
    return mitsuba
