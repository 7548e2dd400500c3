"""One stretch of edge: its intensities, its noise, and what it adds to the normal equations of the pose.

A stretch is a short piece of one edge, over which shading and shadow are constant. Its grey levels are I_i = Σ_a c_a
φ_a(d_i) with two intensities c for a sharp edge and four for a rounded one. They are linear in c, so c is eliminated
(variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 413, 1973): H -= C S⁻¹ Cᵀ, with S the normal matrix of
the intensities and C their coupling to the parameters. No model of the light is needed.

**Robust weights.** Marks and shadows get Tukey's biweight. Its scale comes from the residuals of the same stretch,
because the grain on a die's faces is several times the noise of the still background: first from their median, in the
end by one step of an M-estimate.

**Shared greys.** Where the stretches beside one face of a sharp die, or beside the background, have nearly the same
grey, each also informs the others. Their mean grey and the variance between them come from all of them (DerSimonian and
Laird, Control. Clin. Trials 7, 177, 1986); the mean is a prior on each stretch, is itself an unknown of the frame, and
is eliminated from the equations of a view.

**Slope of the shade.** The background beside a contour gets darker or lighter away from the die, by a slope s about zero of a
stated standard deviation: far above the table, where nothing of the kind is near, that is so small that s costs no information.
s is eliminated before all else, so that what follows is as without it. The derivative of a pixel by the blur leaves out that of
s: a hundredth of it.

**Saturation.** A pixel at full scale says "at least this bright". Where as much is predicted it says nothing else: it has no
weight, and how bright the side of the edge is follows from the pixels between the two. Where less is, it counts as any other.

**Rounding.** In a clip with few grey levels, rounding to steps s wider than its noise has the same error on all pixels
of one grey. The two greys beside an edge are each off by s/√12, and the pixels between, which take all levels, by
nothing on average. That equals an error e = s/√24 of the two greys against the pixels between, and shifts the whole
edge by e Σ|I'| / Σ I'², about 0.7 σ s/|c1 b - c0|. The information of its stretches is reduced until the edge is no
surer than that.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory
from ..placed_die import (
    BLUR,
    CLEAR_PX,
    CONTOUR_PX,
    EXPECTED_CLEAR_PX,
    FACE_EDGES,
    LINE_LAGS,
    LINE_PAIRS,
    LINE_PRODUCTS,
    LINE_SQUARES,
    LINES,
    LOG_NOISE,
    PIXELS,
    RESPONSE,
    ROBUST_COST,
    STRETCHES,
    TAIL_DEGREES,
    WEIGHT_SUM,
    EdgeSampling,
    NormalEquations,
    RefinementSettings,
    Workspace,
    add_stretch_to_light,
    cholesky_factor,
    fill_expected,
    solve_factored,
    used_columns,
)
from .shade import error_of_step_by_slope
from .stretch_sums import (
    CENSORED,
    FAR_OFF,
    censor,
    four_residuals,
    four_sums,
    has_saturated,
    less_ramp,
    median_size,
    ramp_sums,
    robust_scale,
    two_residuals,
    two_sums,
)

FEWEST_PIXELS = 12
"""Pixels of a stretch below which its intensities and its noise are not estimated."""
REWEIGHTINGS = 3
"""Times that the intensities of a stretch are solved with weights from the last residuals."""
BIWEIGHT_CUT = 4.685
"""Cut of the biweight in sigmas: 95 % efficient on clean Gaussian residuals."""
NORMAL_MAD = 1.4826
"""Standard deviation of a Gaussian over its median absolute value."""
FEWEST_STRETCHES = 4.0
"""Stretches beside a face from which the variance of their greys is estimated."""
CLEAR_SIGMAS = 3.0
"""Contrast of a contour, in residual noise, from which its step counts as clear."""
FAINT_SIGMAS = 1.0
"""The same if the stretch has more than FAINT_PIXELS effective pixels, whose mean is surer."""
FAINT_PIXELS = 30
"""Sum of the robust weights of a stretch from which a fainter step is clear."""
STRIP_NOISE_GREY = 2.0
"""Least noise that the prior on a rounded strip is scaled by: on noiseless pictures it would hold nothing."""
LEFT_SHARE = 0.3
"""Part of the deviations from the light that the two intensities of a strip do not describe. They look like a shift of
the edge. Between two faces nothing but the course of the strip shows where the edge is, so that deviations of the usual
size count as well as what is seen beyond them. Single pictures of made dice, matt and glossy, refined from their true
poses with the light of the clip, then had a NEES of 7 to 19; without it 14 to 140."""
LEAST_FILE_NOISE = 0.5
"""Least noise in the file's grey levels: rounding to whole levels leaves 0.3."""
MIXED_SHARE = 0.01
"""Share of either side in a pixel from which it shows both."""
LEAST_PIVOT = 1e-9
"""Part of its diagonal that a pivot of the intensities keeps at the least; below, two of them cannot be separated."""
LEAST_SHARED_PIVOT = 1e-12
"""The same of the greys that stretches share."""


class Stretch(NamedTuple):
    """What is constant over one stretch of edge."""

    pixels: np.int64
    rows: np.int64
    """Pixel lines that these lie on."""
    sharp: bool
    """Whether the die has sharp edges."""
    interior: bool
    """Whether both faces beside the edge are visible; the far side is the background otherwise."""
    background_sum: float
    """Sum of the known background over the pixels; their number for an interior edge."""
    length_px: float
    """Length of edge."""
    edge_stretches: float
    """Number of such stretches along the edge: their rounding errors are the same."""
    weight: float
    """Factor on the information."""
    view_index: int
    near: int
    """The near face."""
    far: int
    """The far face, or the number of faces for the background."""
    shade_slope: float
    """Standard deviation of the slope of the shade on the background [1/px]."""


@inner_no_memory
def add_stretch(
    stretch: Stretch, settings: RefinementSettings, sampling: EdgeSampling, work: Workspace, equations: NormalEquations
) -> None:
    """Add one stretch of edge to the normal equations and their statistics.

    The workspace holds its pixels: `basis` with `basis_slope` (and `basis_blur` if `with_blur`), `grey`, `row_begin`
    and `row_jacobian`.
    """
    n, m, sharp, near, far = stretch.pixels, stretch.rows, stretch.sharp, stretch.near, stretch.far
    with_blur, with_response = sampling.with_blur, sampling.with_response
    view, noise_floor = stretch.view_index, settings.noise_floor_grey
    H, g, stats = equations.H, equations.g, equations.statistics
    stats[PIXELS] += n
    stats[STRETCHES] += 1.0
    if not stretch.interior:
        stats[CONTOUR_PX] += stretch.length_px
        stats[EXPECTED_CLEAR_PX] += stretch.length_px
    if n < FEWEST_PIXELS:
        return
    phi, slope, spread, grey, w = work.basis, work.basis_slope, work.basis_blur, work.grey, work.weight
    res, A, L, y, c, C, size, rise = work.residual, work.A, work.L, work.y, work.c, work.C, work.size, work.grey_slope
    K = 2 if sharp else 4
    base = stretch.background_sum / n
    scale, icut, seen = noise_floor, 0.0, n
    sums, shared_grey = work.grey_sums[view], work.shared_grey[view]
    light, tie = work.light, work.tie
    lit = not sharp and light.level[view] > 0.0
    face_tie, strip_tie, tail = 0.0, 0.0, 1.0
    slope_of_shade, square, shown, ramp, coupled = 0.0, 0.0, 0.0, work.ramp, work.ramp_by_intensities
    shaded = not stretch.interior
    if lit:
        fill_expected(view, light)
        deviation = light.deviation[view]
        strip_tie = 1.0 / (stretch.edge_stretches * deviation * deviation)
        face_tie = strip_tie / FACE_EDGES
    tie[:] = 0.0
    known_near, known_far = 0.0, 0.0
    c[2], c[3] = 0.0, 0.0
    res[:n] = 0.0
    is_saturated = has_saturated(n, settings.saturation_grey, work.value)
    if is_saturated:
        # The greys are at least as bright, until the other pixels say otherwise.
        seen, icut = censor(n, settings.saturation_grey, work.value, res, size), 1.0 / FAR_OFF
    for reweighting in range(REWEIGHTINGS):
        if sharp:
            A[0, 0], A[1, 0], A[1, 1], y[0], y[1] = two_sums(n, icut, phi[0], phi[1], grey, res, w)
        else:
            four_sums(n, icut, phi, grey, res, w, A, y)
        if shaded:
            square, shown = ramp_sums(n, K, phi, ramp, grey, w, coupled)
            square += (scale / stretch.shade_slope) ** 2
            for a in range(K):
                y[a] -= coupled[a] * shown / square
                for b in range(a + 1):
                    A[a, b] -= coupled[a] * coupled[b] / square
        if sharp:
            if reweighting == REWEIGHTINGS - 1:
                _note_greys(A, y, scale, sums[near], sums[far])
            known_near, known_far = shared_grey[near, 1] * scale * scale, shared_grey[far, 1] * scale * scale
            A[0, 0] += known_near
            A[1, 1] += known_far
            y[0] += known_near * shared_grey[near, 0]
            y[1] += known_far * shared_grey[far, 0]
        elif lit:
            if reweighting > 0 and light.solved[view] > 0:
                off2, off3 = c[2] - light.expected[2], c[3] - light.expected[3]
                spread2, spread3 = light.spread[0] + 1.0 / strip_tie, light.spread[1] + 1.0 / strip_tie
                tail = (TAIL_DEGREES + 2.0) / (TAIL_DEGREES + off2 * off2 / spread2 + off3 * off3 / spread3)
            tie[0] = face_tie * scale * scale
            tie[1] = tie[0] if stretch.interior else 0.0
            tie[2] = tie[3] = min(tail, 1.0) * strip_tie * scale * scale
            for a in range(4):
                A[a, a] += tie[a]
                y[a] += tie[a] * light.expected[a]
        else:
            level = 0.5 * (abs(y[0] / max(A[0, 0], 1e-9)) + abs(y[1] / max(A[1, 1], 1e-9)) * base) + 1.0
            prior = (max(scale, STRIP_NOISE_GREY) / (settings.strip_prior_share * level)) ** 2
            A[2, 2] += prior
            A[3, 3] += prior
        if not cholesky_factor(A, K, L, LEAST_PIVOT):
            return
        solve_factored(L, K, y, c)
        if sharp:
            two_residuals(n, c[0], c[1], phi[0], phi[1], grey, res, size)
        else:
            four_residuals(n, c, phi, grey, res, size)
        if shaded:
            slope_of_shade = shown
            for a in range(K):
                slope_of_shade -= coupled[a] * c[a]
            slope_of_shade /= square
            less_ramp(n, slope_of_shade, ramp, res, size)
        if is_saturated:
            seen = censor(n, settings.saturation_grey, work.value, res, size)
            if seen < FEWEST_PIXELS:
                return
        if reweighting < REWEIGHTINGS - 1:
            scale = max(noise_floor, NORMAL_MAD * median_size(size, seen))
        else:
            scale = max(noise_floor, robust_scale(n, icut, res))
        icut = 1.0 / (BIWEIGHT_CUT * scale)
    iv = stretch.weight / (scale * scale)
    cost, used = _grey_slopes(n, K, c, icut, slope, res, rise, w)
    if seen < n:
        cost -= float(n - seen)
        for i in range(n):
            w[i] = 0.0 if res[i] == CENSORED else w[i]
    if lit:
        for i in range(n):
            rise[i] += work.known_slope[i]
    if shaded:
        for i in range(n):
            rise[i] += slope_of_shade * phi[1, i]
    rounding_grey = settings.rounding_grey
    if rounding_grey > 0.0:
        correlated = _correlated_shift(n, rise, w)
        iv /= 1.0 + stretch.edge_stretches * iv * rounding_grey * rounding_grey / 24.0 * correlated
    if lit:
        off2, off3 = c[2] - light.expected[2], c[3] - light.expected[3]
        left = max(off2 * off2 + off3 * off3 - 2.0 / strip_tie, 0.0)
        if stretch.interior:
            left += light.deviation[view] * light.deviation[view]
        left *= LEFT_SHARE * LEFT_SHARE * stretch.edge_stretches
        iv /= 1.0 + iv * left * _light_shift(n, L, rise, w, phi, y)
    bent = work.response_slope
    if with_response:
        _fill_response_slopes(n, c[0], phi[0], work.value, res, bent)
    begin, rows, ramped = work.row_begin, work.row_jacobian, work.ramp_by_parameters
    C[:] = 0.0
    ramped[:] = 0.0
    lines = 0
    for k in range(m):
        # All pixels of a line share the derivative of d: sums over its pixels first, then the parameters once.
        rr, re, r0, r1, r2, r3, rs, rb, rt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(begin[k], begin[k + 1]):
            wr = w[i] * rise[i]
            rr += wr * rise[i]
            re += wr * res[i]
            r0 += wr * phi[0, i]
            r1 += wr * phi[1, i]
        if rr > 0.0:
            shift = re * sqrt(iv / (stretch.weight * rr))
            stats[LINES] += 1.0
            stats[LINE_SQUARES] += shift * shift
            for lag in range(min(lines, LINE_LAGS)):
                stats[LINE_PAIRS + lag] += 1.0
                stats[LINE_PRODUCTS + lag] += shift * size[lines - 1 - lag]
            size[lines] = shift
            lines += 1
        if shaded:
            for i in range(begin[k], begin[k + 1]):
                rt += w[i] * rise[i] * ramp[i]
        if not sharp:
            for i in range(begin[k], begin[k + 1]):
                wr = w[i] * rise[i]
                r2 += wr * phi[2, i]
                r3 += wr * phi[3, i]
        if with_blur:
            for i in range(begin[k], begin[k + 1]):
                widen = c[0] * spread[0, i] + c[1] * spread[1, i]
                if not sharp:
                    widen += c[2] * spread[2, i] + c[3] * spread[3, i]
                ws = w[i] * widen
                rs += ws * rise[i]
                H[BLUR, BLUR] += iv * ws * widen
                g[BLUR] += iv * ws * res[i]
                if shaded:
                    ramped[BLUR] += iv * ws * ramp[i]
                for a in range(K):
                    C[BLUR, a] += iv * ws * phi[a, i]
        if with_response:
            for i in range(begin[k], begin[k + 1]):
                wb = w[i] * bent[i]
                rb += wb * rise[i]
                H[RESPONSE, RESPONSE] += iv * wb * bent[i]
                g[RESPONSE] += iv * wb * res[i]
                if shaded:
                    ramped[RESPONSE] += iv * wb * ramp[i]
                for a in range(K):
                    C[RESPONSE, a] += iv * wb * phi[a, i]
        j0, j1, j2, j3 = rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3]
        j4, j5, j6, j7 = rows[k, 4], rows[k, 5], rows[k, 6], rows[k, 7]
        for a in range(BLUR):
            ja = iv * rows[k, a]
            g[a] += ja * re
            C[a, 0] += ja * r0
            C[a, 1] += ja * r1
            C[a, 2] += ja * r2
            C[a, 3] += ja * r3
            ramped[a] += ja * rt
            # The whole row, although the lower half would do: eight sums at once, and the compiler need not assume that H and
            # `rows` overlap.
            jr, h = ja * rr, H[a]
            h[0] += jr * j0
            h[1] += jr * j1
            h[2] += jr * j2
            h[3] += jr * j3
            h[4] += jr * j4
            h[5] += jr * j5
            h[6] += jr * j6
            h[7] += jr * j7
            H[BLUR, a] += ja * rs
            H[RESPONSE, a] += ja * rb
    # H -= C S⁻¹ Cᵀ, with S = A iv.
    top = used_columns(sampling)
    if shaded:
        # The slope of the shade is eliminated first, so that what follows is as without it.
        for b in range(top):
            for a in range(K):
                C[b, a] -= ramped[b] * coupled[a] / square
            for a in range(b, top):
                H[a, b] -= ramped[a] * ramped[b] / (square * iv)
    sharing = known_near > 0.0 or known_far > 0.0
    by_near, by_far = work.shared_coupling[view, near], work.shared_coupling[view, far]
    for b in range(top):
        solve_factored(L, K, C[b], y)
        for a in range(b, top):
            lost = C[a, 0] * y[0] + C[a, 1] * y[1]
            if not sharp:
                lost += C[a, 2] * y[2] + C[a, 3] * y[3]
            H[a, b] -= lost / iv
        if sharing:
            by_near[b] += known_near * y[0]
            by_far[b] += known_far * y[1]
    if lit:
        add_stretch_to_light(view, iv, L, tie, c, C, top, light)
    elif not sharp:
        light.sums[view, 0] += 1.0
        light.sums[view, 1] += c[0]
    if sharing:
        shared, right = work.shared_matrix[view], work.shared_right[view]
        det = A[0, 0] * A[1, 1] - A[1, 0] * A[1, 0]
        shared[near, near] += iv * (known_near - known_near * known_near * A[1, 1] / det)
        shared[far, far] += iv * (known_far - known_far * known_far * A[0, 0] / det)
        both = iv * known_near * known_far * A[1, 0] / det
        shared[near, far] += both
        shared[far, near] += both
        right[near] += iv * known_near * (c[0] - shared_grey[near, 0])
        right[far] += iv * known_far * (c[1] - shared_grey[far, 0])
    stats[ROBUST_COST] += cost
    stats[WEIGHT_SUM] += used
    stats[LOG_NOISE] += n * log(_file_noise(n, settings, work.value, res, size) if settings.response > 0.0 else scale)
    if shaded:
        # Beside a rounded edge the strip lies between the two sides, whose step says less of what is clear.
        contrast, faint = abs(c[1] * base - c[0]), scale
        if sharp:
            faint *= error_of_step_by_slope(A, base, coupled, square)
        if contrast > CLEAR_SIGMAS * scale or (contrast > FAINT_SIGMAS * faint and used > FAINT_PIXELS):
            stats[CLEAR_PX] += stretch.length_px


@inner_no_memory
def _note_greys(A: Any, y: Any, scale: float, near: Any, far: Any) -> None:
    """Add the two intensities that a stretch shows by itself, with their information, to the sums of either side."""
    det = A[0, 0] * A[1, 1] - A[1, 0] * A[1, 0]
    if not det > LEAST_PIVOT * A[0, 0] * A[1, 1]:
        return
    iv = 1.0 / (scale * scale)
    c0, c1 = (A[1, 1] * y[0] - A[1, 0] * y[1]) / det, (A[0, 0] * y[1] - A[1, 0] * y[0]) / det
    p0, p1 = iv * det / A[1, 1], iv * det / A[0, 0]
    near[0] += 1.0
    near[1] += p0
    near[2] += p0 * p0
    near[3] += p0 * c0
    near[4] += p0 * c0 * c0
    far[0] += 1.0
    far[1] += p1
    far[2] += p1 * p1
    far[3] += p1 * c1
    far[4] += p1 * c1 * c1


@inner_no_memory
def eliminate_shared_greys(work: Workspace, view: int, top: int, H: Any, g: Any) -> None:
    """Eliminate the greys that the stretches of one view share from its equations: the `top` leading rows of H (lower
    half) and g.

    The greys themselves are those of the last step until `update_shared_greys`.
    """
    M, X, right = work.shared_matrix[view], work.shared_coupling[view], work.shared_right[view]
    which, y = work.shared_faces[view], work.solved
    count = np.int64(0)
    for f in range(right.shape[0]):
        if M[f, f] > 0.0:
            count += 1
            which[count] = f
    # The used rows move to the front in their order, so that none is overwritten before it is read.
    for i in range(count):
        for j in range(i + 1):
            M[i, j] = M[which[i + 1], which[j + 1]]
        right[i] = right[which[i + 1]]
        for a in range(top):
            X[i, a] = X[which[i + 1], a]
    which[0] = count if cholesky_factor(M, count, M, LEAST_SHARED_PIVOT) else 0
    for a in range(top):
        for i in range(which[0]):
            y[i] = X[i, a]
        solve_factored(M, which[0], y, y)
        for i in range(which[0]):
            g[a] -= y[i] * right[i]
            for b in range(a, top):
                H[b, a] -= y[i] * X[i, b]


@inner_no_memory
def update_shared_greys(work: Workspace, step: Any) -> None:
    """Update the greys that stretches share after a step (6,) of the pose, and the variance of the stretches about
    them.

    A face of one grey informs every edge of it. Light, shadow and grain make stretches differ; each is then left to
    itself.
    """
    sums, shared_grey, y = work.grey_sums, work.shared_grey, work.solved
    for view in range(sums.shape[0]):
        which = work.shared_faces[view]
        for i in range(which[0]):
            y[i] = work.shared_right[view, i]
            for a in range(6):
                y[i] -= work.shared_coupling[view, i, a] * step[a]
        solve_factored(work.shared_matrix[view], which[0], y, y)
        for i in range(which[0]):
            shared_grey[view, which[i + 1], 0] += y[i]
        for f in range(sums.shape[1]):
            count, p, pp = sums[view, f, 0], sums[view, f, 1], sums[view, f, 2]
            pc, pcc = sums[view, f, 3], sums[view, f, 4]
            known = shared_grey[view, f, 1] > 0.0
            shared_grey[view, f, 1] = 0.0
            if count >= FEWEST_STRETCHES:
                mean = pc / p
                beyond = pcc - mean * pc - (count - 1.0)
                spread = max(beyond, sqrt(2.0 * (count - 1.0))) / (p - pp / p)
                if not known:
                    shared_grey[view, f, 0] = mean
                shared_grey[view, f, 1] = 1.0 / spread
            for a in range(5):
                sums[view, f, a] = 0.0
        which[0] = 0


# --- noise and derivatives of a stretch


@inner_no_memory
def file_residual(value: float, residual: float, settings: RefinementSettings) -> float:
    """A residual in the file's grey levels, of a pixel of some value."""
    seen, predicted = max(value, 0.0) / settings.full_scale, max(value - residual, 0.0) / settings.full_scale
    return settings.file_scale * (seen**settings.response - predicted**settings.response)


@inner_no_memory
def _file_noise(n: int, settings: RefinementSettings, value: Any, res: Any, size: Any) -> float:
    """Noise of a stretch in the file's grey levels; `size` is overwritten."""
    seen = 0
    for i in range(n):
        if res[i] < CENSORED:
            size[seen] = abs(file_residual(value[i], res[i], settings))
            seen += 1
    scale = max(NORMAL_MAD * median_size(size, seen), LEAST_FILE_NOISE)
    return max(robust_scale(seen, 1.0 / (BIWEIGHT_CUT * scale), size), LEAST_FILE_NOISE)


@inner_fast_sums_no_memory
def _grey_slopes(n: int, K: int, c: Any, icut: float, slope: Any, res: Any, rise: Any, w: Any) -> tuple[float, float]:
    """Fill `rise`, the derivative of the grey levels by d; return the robust cost and the sum of the weights."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    s0, s1, s2, s3 = slope[0], slope[1], slope[2], slope[3]
    if K == 2:
        for i in range(n):
            rise[i] = c0 * s0[i] + c1 * s1[i]
    else:
        for i in range(n):
            rise[i] = c0 * s0[i] + c1 * s1[i] + c2 * s2[i] + c3 * s3[i]
    cost, used = 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        cost += 1.0 - q * q * q
        used += w[i]
    return cost, used


@inner_no_memory
def response_slope(share: float, near: float, far: float) -> float:
    """Derivative of a pixel by the exponent of the response, with the greys on both sides of an edge held: `near`, of which it
    shows a share, and `far`.

    Blur mixes light and not grey levels. Of two sides a and b, of which a pixel shows the shares φ and 1 - φ, it shows
    (φ a^1/γ + (1 - φ) b^1/γ)^γ; the derivative by γ at 1 is P ln P - φ a ln a - (1 - φ) b ln b, with P = φ a + (1 - φ) b."""
    if share < MIXED_SHARE or share > 1.0 - MIXED_SHARE:
        return 0.0
    a, b = max(near, LEAST_FILE_NOISE), max(far, LEAST_FILE_NOISE)
    mixed = share * a + (1.0 - share) * b
    return mixed * log(mixed) - share * a * log(a) - (1.0 - share) * b * log(b)


@inner_no_memory
def _fill_response_slopes(n: int, near_grey: float, near: Any, value: Any, res: Any, out: Any) -> None:
    """Fill the derivative of each pixel by the exponent of the response."""
    for i in range(n):
        far_grey = (value[i] - res[i] - near[i] * near_grey) / max(1.0 - near[i], MIXED_SHARE)
        out[i] = response_slope(near[i], near_grey, far_grey)


@inner_no_memory
def _light_shift(n: int, L: Any, rise: Any, w: Any, phi: Any, y: Any) -> float:
    """Information about the shift of a stretch, its intensities eliminated, times the square of the shift by a grey level
    of error that has the sign of the slope everywhere."""
    total, squares = 0.0, 0.0
    y0, y1, y2, y3 = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        wr = w[i] * rise[i]
        total += abs(wr)
        squares += wr * rise[i]
        y0 += wr * phi[0, i]
        y1 += wr * phi[1, i]
        y2 += wr * phi[2, i]
        y3 += wr * phi[3, i]
    y[0], y[1], y[2], y[3] = y0, y1, y2, y3
    solve_factored(L, 4, y, y)
    information = squares - y0 * y[0] - y1 * y[1] - y2 * y[2] - y3 * y[3]
    shift = total / max(squares, 1e-30)
    return max(information, 0.0) * shift * shift


@inner_fast_sums_no_memory
def _correlated_shift(n: int, rise: Any, w: Any) -> float:
    """(Σ w |r|)² / Σ w r², with r the derivatives of the grey levels by d: the ratio of the variances of d for
    correlated and for independent errors of n pixels."""
    total, squares = 0.0, 0.0
    for i in range(n):
        total += w[i] * abs(rise[i])
        squares += w[i] * rise[i] * rise[i]
    return total * total / max(squares, 1e-30)
