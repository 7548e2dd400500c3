"""What one frame shows of a face's texture, sampled at the texels of the face's grid."""

from __future__ import annotations

from math import floor, hypot
from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled, inner_no_memory
from ..picture import pixel_of_ray
from .face_geometry import (
    drift_of_rows,
    exposure_shrink,
    face_in_camera,
    face_outline,
    motion_reach_px,
    pixel_of_drifting,
    shrink_face,
)
from .face_light import fit_light, relative_slopes
from .kernel_types import (
    LEARNING_ITERATIONS,
    LEAST_VIEW_COSINE,
    LIGHT_COEFFICIENTS,
    MOST_OCCLUDED,
    NEGLIGIBLE_BLUR_TEXEL2,
    ZERO,
    Faces,
    Frame,
    Optics,
    Workspace,
)
from .texture_blur import blur_on_face, blur_texture, relative_blur

FEWEST_SAMPLES = 60
"""Texels in view (about 34 pixels) below which a frame is not used for a face."""
LEAST_CONTRAST = 0.1
"""Scattered light over that in the middle of the face below which a texel is not used."""
LEAST_PLANE_SIGMAS = 2.0
"""Light over its noise below which a texel of a face of unknown texture is not used."""
UNBOUNDED_GREY = 1e9
"""Ceiling of the noise scale where none is known."""


class TextureSums(NamedTuple):
    """Weighted sums from which the texture of one face is averaged."""

    total: Any
    """(n, n) of texture times weight."""
    weight: Any
    """(n, n) of weights: inverse variances times the importance of the frame."""
    count: Any
    """(n, n) frames that show each texel."""
    blur: Any
    """(2, 3) [m²] not a sum: the blur of the last frame, see `blur_on_face`."""


@compiled(nogil=True)
def sample_texture(
    frame: Frame,
    optics: Optics,
    faces: Faces,
    f: int,
    knots: Any,
    importance: float,
    workspace: Workspace,
    sums: TextureSums,
) -> tuple[float, float]:
    """Add to `sums` what a frame shows of the texture of face f.

    The image is interpolated by cubic convolution (Keys, 1981), whose kernel adds no variance of its own. If the
    texture is known, `knots` (3, n, n) are its values and slopes x, y on the grid: only the texels that `faces.use`
    names are sampled, the light is fitted with the texture, and what disagrees with it is left out. Otherwise a plane
    of light is fitted, and a sample is the grey level over that plane.

    Returns the share of the texels in view that were used, below a half of which nothing is added, and the sum of their
    weights; zeros for a face that is not in view.
    """
    n = sums.total.shape[0]
    known = faces.learned[f]
    E, origin = np.zeros((3, 3)), np.zeros(3)
    K, dist, Rcw, use, texel = optics.matrix, optics.distortion, optics.rotation, faces.use[f], faces.texel
    image, x0, y0, lens_blur, motion = frame.image, frame.x0, frame.y0, sums.blur[0], sums.blur[1]
    position, R, velocity, omega = frame.pose
    offset, sides = faces.offsets[f], faces.counts[f]
    facing = face_in_camera(Rcw, optics.translation, position, R, faces.axes[f], offset, E, origin)
    if facing < LEAST_VIEW_COSINE:
        return 0.0, 0.0
    S, centre = np.zeros((3, 3)), origin - offset * E[2]
    exposure_shrink(Rcw, omega, optics.exposure, S)
    blur_on_face(optics, E, origin, offset, velocity, omega, lens_blur, motion)
    shrink_face(S, centre, offset, E, origin)
    px, planes = np.zeros((sides, 2)), np.zeros((sides, 3))
    drift = drift_of_rows(optics, frame.pose)
    margin = faces.margin + motion_reach_px(K, origin[2], motion)
    if not face_outline(optics, drift, E, origin, faces.corners[f, :sides], margin, px, planes):
        return 0.0, 0.0
    height, width = image.shape
    half = 0.5 * (n - 1)
    relative, values = np.zeros(3), knots[0]
    differs = (
        relative_blur(lens_blur, motion, optics.blur, faces.texture_blur[f], texel, relative) >= NEGLIGIBLE_BLUR_TEXEL2
    )
    if differs and known:
        values = workspace.blurred[blur_texture(values, relative, workspace.blurred)]
    grey, texel_index, steep, texture = workspace.grey, workspace.texel_index, workspace.steep, workspace.texture
    m = ZERO
    for i in range(n):
        b = (i - half) * texel
        for j in range(n):
            if known and use[i, j] == 0:
                continue
            a = (j - half) * texel
            X = origin[0] + a * E[0, 0] + b * E[1, 0]
            Y = origin[1] + a * E[0, 1] + b * E[1, 1]
            Z = origin[2] + a * E[0, 2] + b * E[1, 2]
            u, v = pixel_of_ray(K, dist, X / Z, Y / Z)
            if drift.row_s != 0.0:
                u, v = pixel_of_drifting(optics, drift, X, Y, Z)
            inside = True
            for k in range(sides):
                if planes[k, 0] * u + planes[k, 1] * v + planes[k, 2] < 0.0:
                    inside = False
                    break
            if not inside:
                continue
            ju, iv = floor(u) - x0, floor(v) - y0
            if ju < 1 or iv < 1 or ju + 2 >= width or iv + 2 >= height:
                continue
            s, t = u - x0 - ju, v - y0 - iv
            kx, ky = _cubic_convolution_weights(s), _cubic_convolution_weights(t)
            value, top = 0.0, 0.0
            for r in range(4):
                row = image[iv - 1 + r]
                p0, p1, p2, p3 = row[ju - 1], row[ju], row[ju + 1], row[ju + 2]
                value += ky[r] * (kx[0] * p0 + kx[1] * p1 + kx[2] * p2 + kx[3] * p3)
                top = max(top, p0, p1, p2, p3)
            if top >= faces.saturation:
                continue
            grey[m] = value
            texture[m], steep[m] = 1.0, 1.0
            if known:
                texture[m], steep[m] = values[i, j], hypot(knots[1, i, j], knots[2, i, j])
            workspace.a[m], workspace.b[m] = a / (half * texel), b / (half * texel)
            texel_index[m] = i * n + j
            m += 1
    if m < FEWEST_SAMPLES:
        return 0.0, 0.0
    c, A = np.zeros(LIGHT_COEFFICIENTS), np.zeros((LIGHT_COEFFICIENTS, LIGHT_COEFFICIENTS))
    relative_slopes(steep, m)
    scale = fit_light(m, known, faces, UNBOUNDED_GREY, LEARNING_ITERATIONS, workspace, A, c)
    if scale < 0.0 or (known and c[0] <= 0.0):
        return 0.0, 0.0
    # The sample of each texel replaces its residual, and the sample's weight the robust weight.
    sample, weight = workspace.residual, workspace.weight
    used, weight_sum = 0.0, 0.0
    for k in range(m):
        if known:
            contrast = c[0] + c[4] * workspace.a[k] + c[5] * workspace.b[k]
            if contrast <= LEAST_CONTRAST * c[0]:
                weight[k] = 0.0
                continue
            used += weight[k]
            sample[k] = texture[k] + sample[k] / contrast
            weight[k] *= (contrast / scale) ** 2
        else:
            plane = grey[k] - sample[k]
            weight[k] = 0.0
            if plane > LEAST_PLANE_SIGMAS * scale:
                sample[k] = grey[k] / plane
                weight[k] = (plane / scale) ** 2
                used += 1.0
        weight_sum += weight[k]
    if used < (1.0 - MOST_OCCLUDED) * m:
        return used / m, 0.0
    for k in range(m):
        if weight[k] > 0.0:
            i, j = texel_index[k] // n, texel_index[k] % n
            sums.total[i, j] += importance * weight[k] * sample[k]
            sums.weight[i, j] += importance * weight[k]
            sums.count[i, j] += 1
    return used / m, importance * weight_sum


@inner_no_memory
def _cubic_convolution_weights(s: float) -> tuple[float, float, float, float]:
    """Weights of the four pixels about a point that lies `s` (0 to 1) beyond the second of them."""
    k0, k1, k3 = -0.5 * s * (1.0 - s) ** 2, 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * s * (1.0 - s)
    return k0, k1, 1.0 - k0 - k1 - k3, k3
