"""tracking.picture.edge_stretch."""

from __future__ import annotations

from math import log, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_no_memory
from .kernel_types import BIWEIGHT_CUT, BLUR, FEWEST_STRETCHES, PARAMETERS, REWEIGHTINGS, Workspace
from .robust_greys import four_left, four_sums, median_size, rises, scale_left, shift_alike, two_left, two_sums
from .small_matrices import cholesky_factor, solve_factored


@inner_no_memory
def add_stretch(
    work: Workspace, n: int, m: int, sharp: bool, interior: bool, under_sum: float, walked: float, floor_grey: float,
    weight: float, rounding_grey: float, strip_share: float, strip_grey: float, alike: float, full: bool, view: int,
    near: int, far: int, H: Any, g: Any, stats: Any,
) -> None:  # fmt: skip
    """Add one stretch of edge, n pixels in m rows over `walked` pixels of its length, to the normal equations.

    On the desk: `phi` (4, n), the basis functions of the intensities (near, far, and those of a rounded strip), with
    their derivatives `slope` by d and `spread` by the blur (the last is needed where `full`); `begin` (m + 1) the first
    pixel of each row and `rows` (m, 8) the derivative of d by pose and contour error. `under_sum` is the sum of the far
    side's known background (n between two faces); `weight` multiplies what is added. `near` and `far` are the faces whose greys
    it may share.
    """
    stats[2] += n
    stats[5] += 1.0
    if not interior:
        stats[3] += walked
    if n < 12:
        return
    phi, slope, spread, grey, w, res = work.phi, work.slope, work.spread, work.grey, work.weight, work.left
    A, L, y, c, C, size, rise = work.A, work.L, work.y, work.c, work.C, work.size, work.rise
    K = 2 if sharp else 4
    base = under_sum / n
    scale, icut = floor_grey, 0.0
    greys, usual = work.greys[view], work.usual[view]
    known_near, known_far = 0.0, 0.0
    c[2], c[3] = 0.0, 0.0
    res[:n] = 0.0
    for turn_number in range(REWEIGHTINGS):
        if sharp:
            A[0, 0], A[1, 0], A[1, 1], y[0], y[1] = two_sums(n, icut, phi[0], phi[1], grey, res, w)
            if turn_number == REWEIGHTINGS - 1:
                _note_greys(A, y, scale, greys[near], greys[far])
            known_near, known_far = usual[near, 1] * scale * scale, usual[far, 1] * scale * scale
            A[0, 0] += known_near
            A[1, 1] += known_far
            y[0] += known_near * usual[near, 0]
            y[1] += known_far * usual[far, 0]
        else:
            four_sums(n, icut, phi, grey, res, w, A, y)
            if strip_grey > 0.0:
                prior = (scale / strip_grey) ** 2
            else:
                level = 0.5 * (abs(y[0] / max(A[0, 0], 1e-9)) + abs(y[1] / max(A[1, 1], 1e-9)) * base) + 1.0
                prior = (max(scale, 2.0) / (strip_share * level)) ** 2
            A[2, 2] += prior
            A[3, 3] += prior
        if not cholesky_factor(A, K, L, 1e-9):
            return
        solve_factored(L, K, y, c)
        if sharp:
            two_left(n, c[0], c[1], phi[0], phi[1], grey, res, size)
        else:
            four_left(n, c, phi, grey, res, size)
        if turn_number < REWEIGHTINGS - 1:
            scale = max(floor_grey, 1.4826 * median_size(size, n))
        else:
            scale = max(floor_grey, scale_left(n, icut, res))
        icut = 1.0 / (BIWEIGHT_CUT * scale)
    iv = weight / (scale * scale)
    cost, used = rises(n, K, c, icut, slope, res, rise, w)
    if rounding_grey > 0.0:
        iv /= 1.0 + alike * iv * rounding_grey * rounding_grey / 24.0 * shift_alike(n, rise, w)
    begin, rows = work.begin, work.rows
    C[:] = 0.0
    for k in range(m):
        # All pixels of a row share the derivative of d: sums over the row first, the pose once a row.
        rr, re, r0, r1, r2, r3, rs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(begin[k], begin[k + 1]):
            wr = w[i] * rise[i]
            rr += wr * rise[i]
            re += wr * res[i]
            r0 += wr * phi[0, i]
            r1 += wr * phi[1, i]
        if not sharp:
            for i in range(begin[k], begin[k + 1]):
                wr = w[i] * rise[i]
                r2 += wr * phi[2, i]
                r3 += wr * phi[3, i]
        if full:
            for i in range(begin[k], begin[k + 1]):
                widen = c[0] * spread[0, i] + c[1] * spread[1, i]
                if not sharp:
                    widen += c[2] * spread[2, i] + c[3] * spread[3, i]
                ws = w[i] * widen
                rs += ws * rise[i]
                H[BLUR, BLUR] += iv * ws * widen
                g[BLUR] += iv * ws * res[i]
                for a in range(K):
                    C[BLUR, a] += iv * ws * phi[a, i]
        j0, j1, j2, j3 = rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3]
        j4, j5, j6, j7 = rows[k, 4], rows[k, 5], rows[k, 6], rows[k, 7]
        for a in range(BLUR):
            ja = iv * rows[k, a]
            g[a] += ja * re
            C[a, 0] += ja * r0
            C[a, 1] += ja * r1
            C[a, 2] += ja * r2
            C[a, 3] += ja * r3
            # The whole row, though the lower half would do: eight sums at once, and none that the compiler must take for an
            # overlap of H and `rows`.
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
    # The intensities are eliminated: H -= C S⁻¹ Cᵀ, with S = A iv their own normal matrix.
    top = PARAMETERS if full else BLUR
    sharing = known_near > 0.0 or known_far > 0.0
    by_near, by_far = work.by_shared[view, near], work.by_shared[view, far]
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
    if sharing:
        shared, pull = work.shared[view], work.pull[view]
        det = A[0, 0] * A[1, 1] - A[1, 0] * A[1, 0]
        shared[near, near] += iv * (known_near - known_near * known_near * A[1, 1] / det)
        shared[far, far] += iv * (known_far - known_far * known_far * A[0, 0] / det)
        both = iv * known_near * known_far * A[1, 0] / det
        shared[near, far] += both
        shared[far, near] += both
        pull[near] += iv * known_near * (c[0] - usual[near, 0])
        pull[far] += iv * known_far * (c[1] - usual[far, 0])
    stats[0] += cost
    stats[1] += used
    stats[6] += n * log(scale)
    contrast = abs(c[1] * base - c[0])
    if not interior and (contrast > 3.0 * scale or (contrast > 1.0 * scale and used > 30)):
        stats[4] += walked


@inner_no_memory
def _note_greys(A: Any, y: Any, scale: float, near: Any, far: Any) -> None:
    """Add the two intensities that a stretch alone shows, with their information, to the sums of either side."""
    det = A[0, 0] * A[1, 1] - A[1, 0] * A[1, 0]
    if not det > 1e-9 * A[0, 0] * A[1, 1]:
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
def eliminate(work: Workspace, view: int, top: int, H: Any, g: Any) -> None:
    """Eliminate the greys that the stretches of one view share from its normal equations: the `top` leading rows of H (lower
    half) and g. Those greys are `usual` so far; what they become waits for the step of the pose, see `share_greys`."""
    M, X, pull, which, y = work.shared[view], work.by_shared[view], work.pull[view], work.which[view], work.solved
    count = np.int64(0)
    for f in range(pull.shape[0]):
        if M[f, f] > 0.0:
            count += 1
            which[count] = f
    # Those that count are moved together; their order stays, so that nothing is written before it was read.
    for i in range(count):
        for j in range(i + 1):
            M[i, j] = M[which[i + 1], which[j + 1]]
        pull[i] = pull[which[i + 1]]
        for a in range(top):
            X[i, a] = X[which[i + 1], a]
    which[0] = count if cholesky_factor(M, count, M, 1e-12) else 0
    for a in range(top):
        for i in range(which[0]):
            y[i] = X[i, a]
        solve_factored(M, which[0], y, y)
        for i in range(which[0]):
            g[a] -= y[i] * pull[i]
            for b in range(a, top):
                H[b, a] -= y[i] * X[i, b]


@inner_no_memory
def share_greys(work: Workspace, step: Any) -> None:
    """After a step (6,) of the pose: the greys that stretches share, and how far the stretches beside a face differ from theirs
    beyond their own noise (DerSimonian and Laird, Control. Clin. Trials 7, 177, 1986). A face of one grey helps every edge
    of it; light, shadow and grain make its stretches differ, and each is left to itself."""
    greys, usual, y = work.greys, work.usual, work.solved
    for view in range(greys.shape[0]):
        which = work.which[view]
        for i in range(which[0]):
            y[i] = work.pull[view, i]
            for a in range(6):
                y[i] -= work.by_shared[view, i, a] * step[a]
        solve_factored(work.shared[view], which[0], y, y)
        for i in range(which[0]):
            usual[view, which[i + 1], 0] += y[i]
        for f in range(greys.shape[1]):
            count, p, pp, pc, pcc = (
                greys[view, f, 0],
                greys[view, f, 1],
                greys[view, f, 2],
                greys[view, f, 3],
                greys[view, f, 4],
            )
            known = usual[view, f, 1] > 0.0
            usual[view, f, 1] = 0.0
            if count >= FEWEST_STRETCHES:
                mean = pc / p
                beyond = pcc - mean * pc - (count - 1.0)
                spread = max(beyond, sqrt(2.0 * (count - 1.0))) / (p - pp / p)
                if not known:
                    usual[view, f, 0] = mean
                usual[view, f, 1] = 1.0 / spread
            for a in range(5):
                greys[view, f, a] = 0.0
        which[0] = 0
