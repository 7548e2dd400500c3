"""What the cameras show of a die, apart from its pose: cameras, backgrounds, die and light, prepared for the
kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import cv2
import numpy as np
from numba import config as numba_config
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices, symmetry_rotations
from ...model.throw import Flight, State, turning_of
from ...model.world import GRAVITY_M_S2
from ..camera import Camera
from ..placed_die import (
    SMALLEST_WINDOW_PX,
    WINDOW_PX,
    CameraRig,
    FrameWindows,
    LightPrior,
    PictureModel,
    RefinementSettings,
    Shape,
    unknown_light,
)
from ..quality import STANDARD, Quality
from .edge_equations import STRETCH_PX
from .occluders import OccluderMask, new_occluder_mask
from .segmentation import PixelNoise

Array = NDArray[np.float64]
Image = NDArray[np.float32]

THREADS = min(2, numba_config.NUMBA_NUM_THREADS)
"""Threads for work on frames, or on faces, that are independent of each other; more of them wait for the decoder."""
LEAST_ROUNDED_PX = 0.4
"""Radius of the ball in the picture from which all pixels are compared: bevels are then about half a pixel wide. By edges the
shade of a bevel is free, and one narrower than the blur looks like an edge that lies elsewhere. That loses some dice from half a
pixel on; below, what it leaves open is small. It was chosen on thirteen of 160 random clips, those between 0.45 and 1 px."""
MIRRORED = np.diag([1.0, 1.0, -1.0])
"""Reflection in the table."""

STRIP_SHARE = 2.0
"""Prior on the strips of rounded edges, see `RefinementSettings`, where a pose is refined. Held to half a face's grey,
bevels in glossy paint pulled contours in, and poses came out a permille too far away."""
TRACKED_STRIP_SHARE = 1.0
"""The same while the die is only tracked: as free as where a pose is refined, tracking lost a tetrahedron of one grey
between two bounces."""
LOOSE_REACH = 0.22
"""Standard deviation of the loose prior on a position, in units of the die's reach."""
LOOSE_RAD = 0.1
"""The same of a rotation."""
TIGHT_REACH = 0.03
"""Standard deviation of the tight prior on a position, in units of the die's reach."""
TIGHT_RAD = 0.012
"""The same of a rotation."""
LEAST_NOISE_GREY = 0.5
"""Least noise of a stretch of edge: rounding to whole grey levels leaves 0.3."""
NOISE_FLOOR_SHARE = 0.5
"""The same, in the noise of the still background."""
SHADE_CHANGE = 1.5
"""Standard deviation of the change of the shade on the background over a circumradius, beside a die on the table: of its soft
shadow, and of what it hides of the light from all sides. At half of it dark dice in soft shadows are 0.4 mm off."""
ROUNDED_TRACKING_STEPS = 2
"""Factor on the steps while a rounded die is tracked: the unknown intensities of its strips make the steps shorter."""
ROUNDED_IN_MIRROR = 0.001
"""Weight of a mirrored view of a rounded die. Bevels in a mirror are lit from below and seen at grazing angles: at full
weight they turned poses by a tenth of a degree, several times their stated error. With thirty times that error they
still determine the distance near the mirror, where die and reflection hide each other's contours, better than the die
alone."""


@dataclass(frozen=True)
class Lens:
    """How sharp a lens draws."""

    blur_px: float
    """Standard deviation of the blur where it is in focus."""
    aperture_m: float = 0.0
    """Its diameter; 0 where all depths are taken for equally sharp."""
    focus_m: float = 1.0
    """Depth at which it is in focus."""

    def blur_at_px(self, depth_m: Array, focal_px: float) -> Array:
        """(n,) standard deviation of the blur at some depths, for a focal length: see `placed_die.defocus_variance`."""
        defocus_px = 0.25 * self.aperture_m * focal_px * (1.0 / depth_m - 1.0 / self.focus_m)
        return np.hypot(self.blur_px, defocus_px)

    @property
    def notice(self) -> str:
        """What was found, for the notes of a run."""
        return (
            f"The blur of the die changes with its distance, as that of a lens of {1e3 * self.aperture_m:.0f} mm focused at "
            f"{self.focus_m:.2f} m does; a smaller aperture makes poses more exact."
        )


@dataclass(frozen=True, eq=False)
class View:
    """Everything about the scene that stays the same from frame to frame."""

    cameras: tuple[Camera, ...]
    backgrounds: NDArray[np.float32]
    """(cameras, height, width) the table without the die, in grey levels; smaller pictures are padded."""
    die: Die
    noise_grey: float
    """Standard deviation of a pixel of the still background between frames."""
    exposure_s: float
    """0 if it is not known."""
    blur_px: float
    """Standard deviation of the lens blur, where it is in focus."""
    quality: Quality
    symmetries: Array
    """(order, 3, 3) rotations that map the die's shape onto itself: only marks distinguish its labellings."""
    shape: Shape
    rig: CameraRig
    """The cameras and, if the table reflects, the mirrored cameras behind them."""
    light: LightPrior
    """What is known of the light on a rounded die."""
    rounding_grey: float = 0.0
    """Step between the grey levels of the clip if rounding errors of pixels of one grey are the same; 0 otherwise."""
    level_grey: float = 1.0
    """Unit of thresholds in grey levels, see `PixelNoise`."""
    readout_s: float = 0.0
    """Time from the exposure of the first row to that of the last; 0 for a global shutter."""
    saturation_grey: float = np.inf
    """Level from which a pixel is saturated."""
    gravity_m_s2: float = GRAVITY_M_S2
    """Of the place of the camera, along -z."""
    response_sigma: float = 0.0
    """Standard deviation of the exponent of the cameras' response, grey = light ** exponent, from that of the clip's levels; 0
    where it is known."""
    surface_from_px: float = LEAST_ROUNDED_PX
    """Radius of rounded corners in the picture from which the whole surface of the die is compared, and not its edges."""

    @property
    def camera(self) -> Camera:
        """The first camera, in whose picture initial poses are searched for."""
        return self.cameras[0]

    @property
    def background(self) -> NDArray[np.float32]:
        """(height, width) of the first camera."""
        return np.asarray(self.backgrounds[0, : self.camera.height_px, : self.camera.width_px])

    @property
    def mirror(self) -> bool:
        """Whether the table reflects the die."""
        return len(self.rig.weight) > len(self.cameras)

    @property
    def lens(self) -> Lens:
        """That of the first camera."""
        return Lens(self.blur_px, float(self.rig.aperture[0]), float(self.rig.focus[0]))

    @property
    def inner(self) -> Array:
        """(n, 3) [m] vertices of the sharp body round which the ball of the corner radius rolls."""
        return np.asarray(self.shape.vertices)

    @property
    def reach_m(self) -> float:
        """Distance of the die's farthest point from its centre."""
        return self.die.solid.circumradius

    @property
    def settings(self) -> RefinementSettings:
        """Settings of the refinement of a pose."""
        reach, quality = self.reach_m, self.quality
        least = max(LEAST_NOISE_GREY * self.level_grey, self.rounding_grey / sqrt(12.0))
        noise_floor = max(least, NOISE_FLOOR_SHARE * self.noise_grey)
        return RefinementSettings(
            exposure_s=self.exposure_s,
            blur_px=self.blur_px,
            noise_floor_grey=noise_floor,
            noise_grey=self.noise_grey,
            loose_m=LOOSE_REACH * reach,
            loose_rad=LOOSE_RAD,
            tight_m=TIGHT_REACH * reach,
            tight_rad=TIGHT_RAD,
            fine_steps=quality.fine_steps,
            min_gain=quality.min_gain,
            min_step_px=0.0,
            line_stride=1,
            with_blur=False,
            with_response=self.response_sigma > 0.0,
            region_pixels=quality.region_pixels,
            band_px=quality.band_px,
            rounding_grey=self.rounding_grey,
            strip_prior_share=STRIP_SHARE,
            light=self.light,
            whole_surface=True,
            surface_from_px=self.surface_from_px,
            contour_stretch_px=STRETCH_PX,
            shade_change=SHADE_CHANGE,
            response=0.0,
            full_scale=1.0,
            file_scale=1.0,
            saturation_grey=self.saturation_grey,
        )

    @property
    def tracking_settings(self) -> RefinementSettings:
        """The same while the die is only tracked from frame to frame."""
        quality, sharp = self.quality, self.die.corner_radius_m == 0.0
        return self.settings._replace(
            fine_steps=quality.tracking_steps * (1 if sharp else ROUNDED_TRACKING_STEPS),
            min_step_px=quality.min_step_px,
            line_stride=quality.tracking_line_stride,
            strip_prior_share=TRACKED_STRIP_SHARE,
            with_response=False,
        )

    def shows_surface(self, position_m: Array) -> bool:
        """Whether pictures of the die at a place (3,) are compared pixel by pixel (`surface_equations`), since it is rounded by
        `surface_from_px` or more."""
        depth_m = float(self.camera.rotation[2] @ (position_m - self.camera.centre_m))
        return not self.mirror and self.shape.radius * self.camera.matrix[0, 0] > self.surface_from_px * depth_m

    def exposure_delay_s(self, positions_m: Array) -> Array:
        """(...,) [s] from the time of a frame to the exposure of the row in which the first camera sees each of some points
        (..., 3), which is the time of a pose; 0 for a global shutter and for NaN."""
        if self.readout_s == 0.0:
            return np.zeros(np.shape(positions_m)[:-1])
        rows = self.camera.project(np.asarray(positions_m))[..., 1]
        return np.asarray(np.nan_to_num((rows - self.rig.middle_row[0]) * self.rig.row_s[0]))

    def model(self, settings: RefinementSettings, rig: CameraRig | None = None) -> PictureModel:
        """The record that kernels take, with another camera rig if one is given."""
        return PictureModel(self.backgrounds, self.rig if rig is None else rig, self.shape, settings)


def with_occluder_mask(view: View) -> tuple[View, OccluderMask]:
    """The view with a copy of its backgrounds, which tracking may mask, and an empty mask."""
    return replace(view, backgrounds=view.backgrounds.copy()), new_occluder_mask(view.backgrounds)


def with_reflections(view: View) -> View:
    """The view with the reflections as views of their own; without a mirror the same view."""
    reflected = 1.0 if view.die.corner_radius_m == 0.0 else ROUNDED_IN_MIRROR
    direct = np.arange(len(view.rig.weight)) < len(view.cameras)
    return replace(view, rig=view.rig._replace(weight=np.where(direct, 1.0, reflected)))


def with_first_camera_only(view: View) -> View:
    """The view with the edges of the first camera alone; what hides them stays."""
    weight = np.zeros_like(view.rig.weight)
    weight[0] = 1.0
    return replace(view, rig=view.rig._replace(weight=weight))


def make_view(
    camera: Camera | Sequence[Camera],
    die: Die,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    noise: PixelNoise,
    exposure_s: float | None,
    blur_px: float,
    *,
    mirror: bool = False,
    quality: Quality = STANDARD,
    readout_s: float = 0.0,
    gravity_m_s2: float = GRAVITY_M_S2,
) -> View:
    """Prepare the geometry that all frames share; the arguments are the fields of `View`, and `noise` is three of them.

    `mirror` says that the table reflects the die. The reflection then hides what is behind it, and counts as a view of
    its own after `with_reflections`.
    """
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera)
    pictures = [background] if isinstance(background, np.ndarray) else list(background)
    rig = _camera_rig(cameras, mirror, readout_s)
    return View(
        cameras, stack_pictures(pictures), die, noise.noise_grey, exposure_s or 0.0, blur_px, quality,
        symmetry_rotations(die.solid), _shape_of(die), rig, unknown_light(len(rig.camera)),
        noise.rounding_grey, noise.level_grey, readout_s, gravity_m_s2=gravity_m_s2,
    )  # fmt: skip


def flight_from(view: View, state: State) -> Flight:
    """The free flight of the die in view, from a state on."""
    return Flight(state, np.inf, gravity_m_s2=view.gravity_m_s2, turning=turning_of(view.die))


def with_lens(view: View, lens: Lens) -> View:
    """The view with a lens blur and a depth of field, the same for all cameras."""
    n = len(view.rig.weight)
    rig = view.rig._replace(aperture=np.full(n, lens.aperture_m), focus=np.full(n, lens.focus_m))
    return replace(view, blur_px=lens.blur_px, rig=rig)


def with_corner_radius(view: View, radius_m: float) -> View:
    """The view of the same die with another corner radius [m]. Raises ValueError if it leaves no flat face."""
    die = view.die.with_corner_radius(radius_m)
    return replace(view, die=die, shape=_shape_of(die))


def _shape_of(die: Die) -> Shape:
    """The die as the kernels take it."""
    solid = die.solid
    return Shape(
        np.ascontiguousarray(inner_vertices(solid, die.corner_radius_m)), np.ascontiguousarray(solid.vertices),
        np.ascontiguousarray(solid.normals), np.asarray(solid.offsets - die.corner_radius_m), solid.edges,
        solid.edge_faces, _face_edges(die), float(die.corner_radius_m),
    )  # fmt: skip


def stack_pictures(pictures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
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


def _camera_rig(cameras: tuple[Camera, ...], mirror: bool, readout_s: float) -> CameraRig:
    """The views: every camera, then every camera in the mirror."""
    n = len(cameras)
    twice = [*cameras, *cameras] if mirror else list(cameras)
    rotations = [c.rotation @ MIRRORED if k >= n else c.rotation for k, c in enumerate(twice)]
    partner = [(k + n) % (2 * n) for k in range(2 * n)] if mirror else [-1] * n
    return CameraRig(
        np.ascontiguousarray([c.matrix for c in twice], float), np.ascontiguousarray([c.distortion for c in twice], float),
        np.ascontiguousarray(rotations, float), np.ascontiguousarray([c.translation_m for c in twice], float),
        np.array([k % n for k in range(len(twice))]), np.array(partner), (np.arange(len(twice)) < n).astype(float),
        np.array([readout_s / (c.height_px - 1) for c in twice]), np.array([0.5 * (c.height_px - 1) for c in twice]),
        np.zeros(len(twice)), np.ones(len(twice)),
    )  # fmt: skip


def whole_frame_windows(view: View, image: Image) -> FrameWindows:
    """All pixels of one frame: `image` is (height, width), or (cameras, height, width) for several cameras."""
    pixels = np.ascontiguousarray(image if image.ndim == 3 else image[None], np.float32)
    size = np.array([[c.width_px, c.height_px] for c in view.cameras])
    return FrameWindows(pixels, np.zeros((len(view.cameras), 2), np.int64), size)


def visible_faces(view: View, position_m: Array, rotation: Array) -> NDArray[np.int64]:
    """Indices of the faces that look at the first camera."""
    solid = view.die.solid
    toward = (solid.normals @ rotation.T) @ (view.camera.centre_m - position_m) - solid.offsets
    return np.flatnonzero(toward > 0)


def outline_box(view: View, position_m: Array, rotation: Array, margin_px: float) -> tuple[int, int, int, int] | None:
    """Pixel window x0, y0, x1, y1 (end exclusive) about the projected die, or None if it lies outside the image."""
    px = view.camera.project(view.die.solid.vertices @ rotation.T + position_m)
    if not np.isfinite(px).all():
        return None
    x0, y0 = np.floor(px.min(0) - margin_px).astype(int)
    x1, y1 = np.ceil(px.max(0) + margin_px).astype(int) + 1
    x0, y0 = max(x0, 0), max(y0, 0)
    x1, y1 = min(x1, view.camera.width_px), min(y1, view.camera.height_px)
    large = x1 - x0 > SMALLEST_WINDOW_PX and y1 - y0 > SMALLEST_WINDOW_PX
    return (int(x0), int(y0), int(x1), int(y1)) if large else None


def outline_mask(camera: Camera, corners_m: Array) -> NDArray[np.bool_]:
    """(height, width) the pixels within the convex hull of some corners (n, 3); none if one of them is not before the camera."""
    filled = np.zeros((camera.height_px, camera.width_px), np.uint8)
    px = camera.project(corners_m)
    if np.isfinite(px).all():
        cv2.fillConvexPoly(filled, cv2.convexHull(np.rint(px).astype(np.int32)), 1)
    return filled.astype(bool)


def refinement_boxes(view: View, positions_m: Array, rotations: Array) -> NDArray[np.int64]:
    """(n, cameras, 4) pixels x0, y0, x1, y1 (end exclusive) that hold all that refinements from starts (n, 3), (n, 3,
    3) use, on edges and on surface marks: the die and its reflection in a mirror. A box is empty if its start is NaN or
    out of view."""
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
    """Share of the die's projected vertices inside the picture, 0 to 1, of the camera that shows most of it."""
    return float(shares_in_view(view, np.asarray(position_m)[None], np.asarray(rotation)[None])[0])


def shares_in_view(view: View, positions_m: Array, rotations: Array) -> Array:
    """(n,) the same for many poses (n, 3), (n, 3, 3); 0 where a pose is NaN."""
    points = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    shares = []
    for camera in view.cameras:
        shares.append(camera.contains(camera.project(points)).mean(1))
    return np.asarray(np.max(shares, axis=0))
