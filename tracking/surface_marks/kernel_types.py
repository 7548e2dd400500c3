"""tracking.surface_marks.kernel_types."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled, int64, truth

GAINS = 6
"""Light on one face of one frame: T, 1, a, b, aT, bT. What the paint scatters follows the texture T, what it mirrors lies over
it; either changes linearly over the face."""
PLAIN = 4
"""Those of them that a face of unknown texture has, T being 1."""
GRADIENT = 0.3
"""Standard deviation of the prior on how much the scattered light changes from the middle of a face to its border, as a share: a
small mark seen through much noise does not show it."""
WARPS = 9
"""Ways in which a texture may lie wrongly on its face: shift (2), linear map (4), and the two terms by which a plane seen from
another side differs from that. Poses that are wrong alike on all frames warp what is learned from them in just these. The last
one is blur."""
SHARED = 1
"""Numbers shared by all faces and frames: the lens blur."""
STEEP = 0.3
"""Share of the steepest slope on a face from which a pixel counts as steep."""
THINNED = 3
"""Of the pixels on flat ground beside marks every third is enough for the six numbers of light."""
NO_BLUR = 0.02
"""Variance [texel²] below which more or less blur is left out: a texture's own is about one."""
BLUR_STEP = 1.15
"""Factor on the lens blur for its difference quotient. Its derivative proper would rest on the texture's curvature at one place,
and so on its noise, which every look that it was learned from shares: blurs came out a quarter too large."""
STENCIL_BLUR = 2.0
"""Variance [texel²] up to which a texture is blurred by three values in a row, a texel apart, some times over. More is blurred by
values twice as far apart, from four times as much on four times, and so on, each after one turn of those nearer to each other:
values far apart leave what lies between them as it is. Three values √3 standard deviations apart, weighted 1/6, 2/3 and 1/6,
blur a quintic as a normal distribution does; the turns here are about as wide, and right for cubics."""
EVERY_THIRD, MANY = 3, 600
"""On the way one pixel in three tells the scale of the residuals well enough, where a face has so many."""
BUFFER = 60_000
"""Pixels of one face at the most; larger faces are walked on every second, third, ... row."""
TUKEY = 4.685
"""Cut of the biweight in sigmas: 95 % efficient on clean Gaussian residuals."""
GRAZING = 0.2
"""Cosine of the view below which a face is left out: it is squeezed five times, and its blur is that of other faces."""
MARGIN_BLURS = 2.5
"""Blurs, and half a pixel, by which pixels of a face stay away from where its flat part ends: 0.6 % of the step beyond
the edge are left there."""
SETTLED_PX = 0.1
"""A step of the refinement that moves no point by more is the last one: marks are blurred over five times as much at least, and
what the next step would move is of second order in that share."""
OVERSTEP = 1.2
"""Factor on the steps of the refinement. With the weights of the last residuals kept, as here, the normal equations are steeper
than the robust cost: by the ratio of the means of the biweight and of its influence function's slope, 0.915 to 0.758 for
Gaussian residuals. One plain step left a sixth of the way."""
MOST_HIDDEN = 0.5
"""Share of a face's pixels, or texels, that may be unlike its texture before the face is left out of a frame."""


FIRST, ALL, POSE, LOOKING, FITTING = int64(0), int64(GAINS), int64(6), int64(4), int64(3)
NO_PLACES, KNOWN, MOST = truth(False), truth(True), int64(BUFFER)
"""Numbers that are handed on: as literals each would be compiled apart, with all that it is handed to."""


class Optics(NamedTuple):
    """The camera, and what blurs its pictures."""

    rays: Any
    """(height, width, 2) camera rays x/z, y/z of the pixels of the whole picture, lens distortion undone."""
    matrix: Any
    """(3, 3) [px]"""
    distortion: Any
    """(5,)"""
    rotation: Any
    """(3, 3) world to camera."""
    translation: Any
    """(3,) [m]"""
    exposure: float
    """[s]"""
    blur: float
    """[px] of the lens."""


class Faces(NamedTuple):
    """The die's faces with what they show, and how pixels are compared with it."""

    axes: Any
    """(faces, 3, 3) rows a, b and the outward normal, body axes."""
    offsets: Any
    """(faces,) [m]"""
    corners: Any
    """(faces, most, 2) [m] of the flat part in (a, b), padded."""
    counts: Any
    """(faces,) corners of each."""
    base: Any
    """(faces, 2, 3) [m²] blur of the textures, see `blur_on_face`."""
    coefficients: Any
    """(faces, n, n) of the splines."""
    use: Any
    """(faces, n, n) 0 where no pixel looks, 1 where few do because the texture is flat, 2 where all do."""
    usual_grey: Any
    """(faces,) usual residual of a pixel; 0 for a face that shows nothing."""
    margin: float
    """[px] by which pixels stay away from where the flat part ends."""
    texel: float
    """[m]"""
    saturation: float
    """[grey] from which pixels tell nothing."""
    floor_grey: float
    """Least noise."""
    cut: float
    """Of the robust weights [sigmas]."""


class Bench(NamedTuple):
    """Room for the pixels of one face, taken once for many frames."""

    grey: Any
    texture: Any
    a: Any
    b: Any
    """Light changes with these: face coordinates, one at the grid's border."""
    steep: Any
    weight: Any
    left: Any
    size: Any
    where: Any
    slope: Any
    """(2, most) of the texture by a and b [1/m]."""
    ray: Any
    """(2, most)"""
    softer: Any
    """(2, most) derivatives of the texture by its own variance [1/texel²] and by the lens blur [1/px]."""
    by: Any
    """(6 + WARPS + SHARED, most) derivatives of the grey levels by all that they may depend on."""
    heavy: Any
    """(most,) one of them, times its weight."""
    soft: Any
    """(4, n, n) textures that are being blurred."""
    line: Any
    """(2, most) where the pixels of one line lie on the face [texel]."""


@compiled(nogil=True)
def new_bench(most: int, side: int) -> Bench:
    """A bench for `most` pixels of a face, and textures of `side` texels a side."""
    return Bench(
        np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most),
        np.empty(most), np.empty(most, np.int64), np.empty((2, most)), np.empty((2, most)), np.empty((2, most)),
        np.empty((6 + WARPS + SHARED, most)), np.empty(most), np.empty((4, side, side)), np.empty((2, most)),
    )  # fmt: skip
