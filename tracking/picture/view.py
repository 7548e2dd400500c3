"""tracking.picture.view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numba import config as numba_config
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices, symmetry_rotations
from ..camera import Camera
from ..quality import STANDARD, Quality
from .kernel_types import LIGHT_TERMS, WINDOW_PX, CameraRig, FrameWindows, OccluderMask, RefinementSettings, Shape
from .region_cost import region_costs_in_box

Array = NDArray[np.float64]

THREADS = min(2, numba_config.NUMBA_NUM_THREADS)
"""Frames, and faces, are independent of each other in most of what is done with them; more threads than this wait for the
decoder."""
Image = NDArray[np.float32]

MIRRORED = np.diag([1.0, 1.0, -1.0])
"""Reflection in the table."""
CONTOUR = 6
"""Column of the contour error in the normal equations."""


@dataclass(frozen=True, eq=False)
class View:
    """What the cameras show of a die: everything about the scene that stays the same from frame to frame."""

    cameras: tuple[Camera, ...]
    backgrounds: NDArray[np.float32]
    """(cameras, height, width) the table without the die, in grey levels; smaller pictures are padded."""
    die: Die
    noise_grey: float
    """Standard deviation of a pixel of the still background between frames."""
    exposure_s: float
    """0 where it is not known."""
    blur_px: float
    """Standard deviation of the lens blur."""
    quality: Quality
    symmetries: Array
    """(order, 3, 3) rotations that leave the die's shape as it is: nothing but marks tells its labellings apart."""
    shape: Shape
    rig: CameraRig
    """The cameras, and behind them the cameras as the table mirrors them where it does."""
    light: Array
    """(views, LIGHT_TERMS + 2) what is known of the light, see `edges`; zero where that is nothing."""
    rounding_grey: float = 0.0
    """Step between the grey levels of the clip where rounding errs alike on pixels of one grey; 0 where it does not."""

    @property
    def camera(self) -> Camera:
        """The first camera, in whose picture a start is looked for."""
        return self.cameras[0]

    @property
    def background(self) -> NDArray[np.float32]:
        """(height, width) of the first camera."""
        return np.asarray(self.backgrounds[0, : self.camera.height_px, : self.camera.width_px])

    @property
    def inner(self) -> Array:
        """(n, 3) [m] vertices of the sharp body round which the ball of the corners' radius rolls."""
        return np.asarray(self.shape.vertices)

    @property
    def reach_m(self) -> float:
        """Farthest point of the die from its centre."""
        return self.die.solid.circumradius

    @property
    def settings(self) -> RefinementSettings:
        """The numbers that the compiled refinement wants."""
        reach, quality = self.reach_m, self.quality
        floor_grey = max(0.5, 0.5 * self.noise_grey, self.rounding_grey / sqrt(12.0))
        return RefinementSettings(
            self.exposure_s, self.blur_px, floor_grey, self.noise_grey, LOOSE_REACH * reach,
            LOOSE_RAD, TIGHT_REACH * reach, TIGHT_RAD, quality.fine_steps, quality.min_gain, 0.0, 1, False,
            quality.region_pixels, quality.band_px, self.rounding_grey, STRIP_SHARE,
            self.light,
        )  # fmt: skip

    @property
    def tracking_settings(self) -> RefinementSettings:
        """The same while the die is only followed."""
        # What is unknown of a rounded die's strips makes the steps shorter.
        steps = self.quality.tracking_steps * (1 if self.die.corner_radius_m == 0.0 else 2)
        return self.settings._replace(
            fine_steps=steps,
            settled_px=self.quality.min_step_px,
            stride=self.quality.tracking_stride,
            strip_share=FOLLOWED_STRIP_SHARE,
        )


def with_occluder_mask(view: View) -> tuple[View, OccluderMask]:
    """The view with backgrounds of its own, in which the chase may note what stands before the die."""
    still, shape = view.backgrounds, view.backgrounds.shape
    occluders = OccluderMask(still, np.zeros(shape, np.uint8), np.zeros(shape, np.uint8), np.zeros(1, np.int64))
    return replace(view, backgrounds=still.copy()), occluders


ROUNDED_IN_MIRROR = 0.001
"""Weight of what a mirror shows of a rounded die. Bevels in a mirror are lit from below and seen at a glance: as a view like any
other they turned poses by a tenth of a degree, several times what its sigmas said. Thirty times these sigmas still tell the
distance near the mirror, where die and reflection hide each other's contours, better than the die alone."""


def with_reflections(view: View) -> View:
    """The view with what the mirror shows as views of their own; without a mirror the same view."""
    reflected = 1.0 if view.die.corner_radius_m == 0.0 else ROUNDED_IN_MIRROR
    direct = np.arange(len(view.rig.weight)) < len(view.cameras)
    return replace(view, rig=view.rig._replace(weight=np.where(direct, 1.0, reflected)))


def seen_by_first(view: View) -> View:
    """The view with the edges of the first camera alone; what hides them stays."""
    weight = np.zeros_like(view.rig.weight)
    weight[0] = 1.0
    return replace(view, rig=view.rig._replace(weight=weight))


STRIP_SHARE, FOLLOWED_STRIP_SHARE = 2.0, 1.0
"""How far the strips of rounded edges may differ from their faces, see `RefinementSettings`, where a pose is refined
and while the die is only followed. Held to half a face's grey, bevels in glossy paint drew contours in, and poses came out a
permille too far away; as free as here at first, a tetrahedron of one grey was lost between two bounces."""
LOOSE_REACH, LOOSE_RAD, TIGHT_REACH, TIGHT_RAD = 0.22, 0.1, 0.03, 0.012
"""Bounds of the prior's standard deviations, positions in units of the die's reach: see `RefinementSettings`."""


def make_view(
    camera: Camera | Sequence[Camera],
    die: Die,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    noise_grey: float,
    exposure_s: float | None,
    blur_px: float,
    *,
    rounding_grey: float = 0.0,
    mirror: bool = False,
    quality: Quality = STANDARD,
) -> View:
    """Prepare the geometry that every frame shares. `mirror`: the table reflects the die. The reflection then hides what
    it hides, and counts as a view of its own after `with_reflections`. The other numbers are those of the `View`."""
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera)
    pictures = [background] if isinstance(background, np.ndarray) else list(background)
    rig = _camera_rig(cameras, mirror)
    return View(
        cameras, stacked(pictures), die, noise_grey, exposure_s or 0.0, blur_px, quality,
        symmetry_rotations(die.solid), _shape_of(die), rig, np.zeros((len(rig.camera), LIGHT_TERMS + 2)), rounding_grey,
    )  # fmt: skip


def rounded(view: View, radius_m: float) -> View:
    """The view of the same die with corners of another radius [m]. Raises ValueError for one that leaves no flat face."""
    die = replace(view.die, corner_radius_m=radius_m)
    return replace(view, die=die, shape=_shape_of(die))


def _shape_of(die: Die) -> Shape:
    """The die as the kernels want it."""
    solid = die.solid
    return Shape(
        np.ascontiguousarray(inner_vertices(solid, die.corner_radius_m)), np.ascontiguousarray(solid.vertices),
        np.ascontiguousarray(solid.normals), np.asarray(solid.offsets - die.corner_radius_m), solid.edges,
        solid.edge_faces, _face_edges(die), float(die.corner_radius_m),
    )  # fmt: skip


def stacked(pictures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Pictures of several cameras as one stack (cameras, height, width), smaller ones padded with zeros."""
    if len(pictures) == 1:
        return np.ascontiguousarray(pictures[0], np.float32)[None]
    height, width = max(p.shape[0] for p in pictures), max(p.shape[1] for p in pictures)
    out = np.zeros((len(pictures), height, width), np.float32)
    for k, picture in enumerate(pictures):
        out[k, : picture.shape[0], : picture.shape[1]] = picture
    return out


def _face_edges(die: Die) -> NDArray[np.int64]:
    """(faces, most) edges of each face, padded with -1."""
    solid = die.solid
    most = max(len(face) for face in solid.faces)
    table = np.full((len(solid.faces), most), -1, np.int64)
    fill = [0] * len(solid.faces)
    for e, pair in enumerate(solid.edge_faces):
        for f in pair:
            table[f, fill[f]] = e
            fill[f] += 1
    return table


def _camera_rig(cameras: tuple[Camera, ...], mirror: bool) -> CameraRig:
    """The views: every camera, then every camera in the mirror."""
    n = len(cameras)
    twice = [*cameras, *cameras] if mirror else list(cameras)
    rotations = [c.rotation @ MIRRORED if k >= n else c.rotation for k, c in enumerate(twice)]
    partner = [(k + n) % (2 * n) for k in range(2 * n)] if mirror else [-1] * n
    return CameraRig(
        np.ascontiguousarray([c.matrix for c in twice], float), np.ascontiguousarray([c.distortion for c in twice], float),
        np.ascontiguousarray(rotations, float), np.ascontiguousarray([c.translation_m for c in twice], float),
        np.array([k % n for k in range(len(twice))]), np.array(partner), (np.arange(len(twice)) < n).astype(float),
    )  # fmt: skip


def whole_frame_windows(view: View, image: Image) -> FrameWindows:
    """All pixels of one frame: `image` is (height, width), or (cameras, height, width) for several cameras."""
    pixels = np.ascontiguousarray(image if image.ndim == 3 else image[None], np.float32)
    size = np.array([[c.width_px, c.height_px] for c in view.cameras])
    return FrameWindows(pixels, np.zeros((len(view.cameras), 2), np.int64), size)


def visible_faces(view: View, position_m: Array, rotation: Array) -> NDArray[np.int64]:
    """Indices of the faces that look at the camera."""
    solid = view.die.solid
    toward = (solid.normals @ rotation.T) @ (view.camera.centre_m - position_m) - solid.offsets
    return np.flatnonzero(toward > 0)


def outline_box(view: View, position_m: Array, rotation: Array, margin_px: float) -> tuple[int, int, int, int] | None:
    """Pixel window x0, y0, x1, y1 (end exclusive) round the drawn die, or None where it lies outside the image."""
    px = view.camera.project(view.die.solid.vertices @ rotation.T + position_m)
    if not np.isfinite(px).all():
        return None
    x0, y0 = np.floor(px.min(0) - margin_px).astype(int)
    x1, y1 = np.ceil(px.max(0) + margin_px).astype(int) + 1
    x0, y0 = max(x0, 0), max(y0, 0)
    x1, y1 = min(x1, view.camera.width_px), min(y1, view.camera.height_px)
    return (int(x0), int(y0), int(x1), int(y1)) if x1 - x0 > 4 and y1 - y0 > 4 else None


def refinement_boxes(view: View, positions_m: Array, rotations: Array) -> NDArray[np.int64]:
    """(n, cameras, 4) pixels x0, y0, x1, y1 (end exclusive) that hold all that a refinement from each start (n, 3), (n, 3, 3)
    looks at (`crop_windows`, `marks`): the die and its reflection in a mirror; empty where a start is NaN or out of view."""
    boxes = np.zeros((len(positions_m), len(view.cameras), 4), np.int64)
    points = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    for c, camera in enumerate(view.cameras):
        size = np.array([camera.width_px, camera.height_px])
        low, high = np.full((len(points), 2), np.inf), np.full((len(points), 2), -np.inf)
        for v in np.flatnonzero(view.rig.camera == c):
            seen = camera.project(points if v < len(view.cameras) else points @ MIRRORED)
            good = np.isfinite(seen).all(axis=(1, 2))
            low[good] = np.minimum(low[good], seen[good].min(1))
            high[good] = np.maximum(high[good], seen[good].max(1))
        boxes[:, c, :2] = np.clip(np.floor(low - WINDOW_PX), 0, size)
        boxes[:, c, 2:] = np.clip(np.ceil(high + WINDOW_PX) + 1, 0, size)
        boxes[~(boxes[:, c, 2:] > boxes[:, c, :2]).all(1), c] = 0
    return boxes


def share_in_view(view: View, position_m: Array, rotation: Array) -> float:
    """Share of the die's projected vertices that lie inside the picture, 0 to 1, of the camera that shows most of it."""
    return float(shares_in_view(view, np.asarray(position_m)[None], np.asarray(rotation)[None])[0])


def shares_in_view(view: View, positions_m: Array, rotations: Array) -> Array:
    """(n,) the same for many poses (n, 3), (n, 3, 3); 0 where a pose is NaN."""
    points = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    shares = []
    for camera in view.cameras:
        px = camera.project(points)
        inside = (px >= 0).all(2) & (px[..., 0] <= camera.width_px - 1) & (px[..., 1] <= camera.height_px - 1)
        shares.append(inside.mean(1))
    return np.asarray(np.max(shares, axis=0))


def region_costs(
    view: View, image: Image, box: tuple[int, int, int, int], positions_m: Array, rotations: Array, samples: int
) -> tuple[Array, Array]:
    """How badly each of many drawn dice explains the window `box` (x0, y0, x1, y1; end exclusive) of the first camera's
    picture (mean truncated squared sigmas), and the share of its pixels that differ from the background."""
    score, differs = np.empty(len(positions_m)), np.empty(len(positions_m))
    region_costs_in_box(
        np.ascontiguousarray(image, np.float32), view.backgrounds[0], view.rig, view.shape, *box,
        np.ascontiguousarray(positions_m, float), np.ascontiguousarray(rotations, float), view.noise_grey, samples,
        score, differs,
    )  # fmt: skip
    return score, differs
