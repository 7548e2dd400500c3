"""A camera's view of a throw: path-traced with Mitsuba 3 (Jakob et al., 2022), pixel for pixel what footage would hold.

What is drawn: the die with its marks and rounded corners, in glossy paint; a textured or reflecting table; a lamp of
finite size, whose shadow has soft borders, and the dim light of a room; the die's contact shadow, its image in a mirror,
glare (`film_set`). The camera is the calibrated one, lens distortion included (`lens`).

**Exposure.** A frame is the mean over instants spread evenly through the exposure, so many that no corner moves more than
`MOMENT_PX` between two of them: motion blur as it is, also across an impact.

**Effort.** The empty table is rendered once, well. Of every frame only a window about the die (and its mirror image) is
rendered, and blended into the empty table over `FEATHER_PX`. Where the die only shades the table, the empty table is
multiplied by the ratio of two coarse pictures, with and without the die.

Nothing here computes physics: the poses are those of the `Throw` that is given.
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
from .image_boxes import Box, blend, box_about, merged, part_of, rounded_up
from .lens import FINER, optics_of
from .mitsuba_scene import UPSIDE_DOWN, Appearance, scene_of, sensor_axes
from .table_textures import is_mirror

Array = NDArray[np.float64]

MOMENT_PX = 0.4
"""Below the lens blur, so that the instants of an exposure run together."""
MOST_MOMENTS = 24
"""Motion blur beyond 10 px falls into steps; such footage is beyond use anyway."""
EMPTY_EFFORT = 4
"""The empty table gets so many times the samples of a frame."""
MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0])
"""A point to its image in the table."""
CHUNK_PX_SAMPLES = 40_000_000
"""Samples that Mitsuba draws at once: 2 GB in its vectorised variants."""
FAR_AWAY = np.array([0.0, -50.0, 50.0])
"""Where the die is out of the way [m]."""
SHADE_SAMPLES, SHADE_BLUR_PX = 4, 1.5
"""Light paths for each pixel that is only shaded, and the blur of the shade: lamps of finite size cast no sharper one."""
WINDOW_STEP_PX = 32
"""Windows come in multiples of this: Mitsuba's compiled variants spend 0.3 s on every size that is new to them."""
BRIGHTEST_SHADE = 1.15
"""A die lights the table up by less than this; what is brighter is a single unlikely path."""


class NoRendererError(ValueError):
    """Mitsuba, which comes with the extra `film`, is not installed."""


@dataclass(frozen=True)
class RenderSettings:
    """What rendering may cost."""

    samples: int = 48
    """Light paths for each pixel of a frame. The noise they leave is to stay below the sensor's."""
    threads: int = 1
    variant: str = "scalar_rgb"
    """Of Mitsuba. `llvm_ad_mono` is twice as fast where a recent LLVM library is installed."""

    def __post_init__(self) -> None:
        if self.samples < 1 or self.threads < 1:
            raise ValueError(f"samples = {self.samples}, threads = {self.threads}: wanted 1 or more of each")


def frame_light(studio: FilmRenderer, throw: Throw, times_s: Array, exposure_s: float) -> Iterator[Array]:
    """The light (height, width) of each frame, 1.0 where it fills the sensor; `times_s` (n,) are mid-exposures."""
    for number, time_s in enumerate(times_s):
        yield studio.light(*_poses(studio, throw, float(time_s), exposure_s), seed=number)


def _poses(studio: FilmRenderer, throw: Throw, time_s: float, exposure_s: float) -> tuple[Array, Array]:
    """Positions (m, 3) and quaternions (m, 4) through an exposure, no corner moving much from one to the next."""
    ends = throw.poses(time_s + exposure_s * np.array([-0.5, 0.0, 0.5]))
    corners = studio.corners_px(*ends)
    path = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(1).sum()
    count = int(np.clip(np.ceil(path / MOMENT_PX), 1, MOST_MOMENTS)) if np.isfinite(path) else 1
    share = (np.arange(count) + 0.5) / count - 0.5
    return throw.poses(time_s + exposure_s * share)


class FilmRenderer:
    """The scene in Mitsuba, ready to be photographed with the die anywhere. Holds state: one die is moved about."""

    def __init__(
        self,
        die: Die,
        camera: Camera,
        surface: str,
        look: Appearance,
        *,
        blur_px: float = 0.6,
        effort: RenderSettings = RenderSettings(),
    ) -> None:
        """Raises NoRendererError without Mitsuba, and ValueError for a blur below what pixels have."""
        if blur_px < 0.4:
            raise ValueError(f"blur_px = {blur_px}: wanted 0.4 or more, a pixel alone spreads light over 0.3")
        self.die, self.camera, self.look, self.effort = die, camera, look, effort
        self._mirror = is_mirror(surface)
        self._optics = optics_of(camera, blur_px)
        self._mi = _mitsuba(effort)
        self._scene = self._mi.load_dict(scene_of(self._mi, die, self._optics, surface, look))
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
            self._place(FAR_AWAY, np.array([1.0, 0.0, 0.0, 0.0]))
            whole = (0, 0, self.camera.width_px, self.camera.height_px)
            self._empty = self._render(whole, EMPTY_EFFORT * self.effort.samples, seed=2**31)
        return self._empty

    def light(self, positions_m: Array, quaternions: Array, *, seed: int) -> Array:
        """The light of an exposure over poses (m, 3), (m, 4), each for an equal part of it."""
        picture = self.empty().copy()
        near, shaded = self._windows(positions_m, quaternions)
        for box in shaded:
            blend(picture, self._shade(box, positions_m, quaternions, seed) * picture[part_of(box)], box)
        samples = max(1, round(self.effort.samples / len(positions_m)))
        for box in near:
            window = np.zeros((box[3] - box[1], box[2] - box[0]))
            for k, (position, quaternion) in enumerate(zip(positions_m, quaternions, strict=True)):
                self._place(position, quaternion)
                window += self._render(box, samples, seed=seed * MOST_MOMENTS + k) / len(positions_m)
            blend(picture, window, box)
        return picture

    def _shade(self, box: Box, positions_m: Array, quaternions: Array, seed: int) -> Array:
        """Factor on the light of the table in a window: with the die over without it, along the same light paths.

        What the paths have in common, texture and most of their noise, cancels, and the rest is smooth and is smoothed.
        """
        chosen = np.unique(np.linspace(0, len(positions_m) - 1, SHADE_SAMPLES).round().astype(int))
        samples = max(1, SHADE_SAMPLES // len(chosen))
        total = np.zeros((2, box[3] - box[1], box[2] - box[0]))
        for k in chosen:
            for row, position in enumerate((positions_m[k], FAR_AWAY)):
                self._place(position, quaternions[k])
                total[row] += self._render(box, samples, seed=seed * MOST_MOMENTS + int(k))
        total[0] = np.minimum(total[0], BRIGHTEST_SHADE * total[1])
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
        """The light of a window (left, top, right, bottom) of the real picture."""
        fine = self._optics.rendered_box(box)
        self._aim(fine)
        samples = max(1, samples // (FINER**2 if self._optics.places is not None else 1))
        at_once = max(1, CHUNK_PX_SAMPLES // ((fine[2] - fine[0]) * (fine[3] - fine[1])))
        passes = int(np.ceil(samples / at_once))
        total = np.zeros((fine[3] - fine[1], fine[2] - fine[0]))
        for k in range(passes):
            rendered = self._mi.render(self._scene, spp=int(np.ceil(samples / passes)), seed=(seed * 64 + k) % 2**32)
            total += np.asarray(rendered, float)[..., 0] / passes
        return self._gain * self._optics.to_real_image(total, box, fine)

    def _aim(self, fine: Box) -> None:
        """Show this box of the ideal picture alone.

        As a camera of its own with another principal point, not as a crop of the whole picture: where a crop lies is a
        constant of Mitsuba's compiled code, which would be compiled again for every frame (0.3 s).
        """
        size = [fine[2] - fine[0], fine[3] - fine[1]]
        for name in ("size", "crop_size"):
            self._handles[f"sensor.film.{name}"] = size
        for name, value in sensor_axes(self._optics, fine).items():
            self._handles[f"sensor.{name}"] = value
        self._handles.update()

    def _windows(self, positions_m: Array, quaternions: Array) -> tuple[list[Box], list[Box]]:
        """Boxes of the picture about the die and, on a mirror, its image; and about what the die shades."""
        corners = (
            self.die.solid.vertices @ matrix_from_quat(quaternions).transpose(0, 2, 1) + positions_m[:, None]
        ).reshape(-1, 3)
        near = [corners, corners * UPSIDE_DOWN] if self._mirror else [corners]
        shaded = [self._shaded(corners, positions_m)]
        boxes = [[box_about(self.camera.project(points), self.camera) for points in group] for group in (near, shaded)]
        seen_near, seen_shaded = ([box for box in group if box is not None] for group in boxes)
        return (
            [rounded_up(box, self.camera, WINDOW_STEP_PX) for box in merged(seen_near)],
            [rounded_up(box, self.camera, 2 * WINDOW_STEP_PX) for box in seen_shaded],
        )

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


def _mitsuba(effort: RenderSettings) -> Any:
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
