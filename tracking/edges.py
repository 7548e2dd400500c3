"""What the pixels say about the edges of a die: the normal equations of one pose, and the steps that solve them.

Every visible edge is walked along whole pixel rows or columns, each real pixel once and without interpolation, so that
the noise of neighbouring samples stays independent and the covariance honest. Across an edge, at signed distance d [px]
from its projection, the image is modelled as

    I(d) = c0 [1 - a] + c1 b a,      a = Φ(d / σ)

where c0 is the face on the near side and c1 the other face (b = 1), or the shade on the known background (b = B, the
background without the die: c1 = 1 in full light and less in the die's own shadow). The intensities of a short stretch
of edge are eliminated from the equations (variable projection), and no model of the light is needed.

A rounded die is a smaller sharp body with a ball rolled round it. Its contour is that body's contour pushed out by the
radius, and what lies between a flat face and the contour, or between two flat faces, is a strip on which the surface
normal turns from one to the other. With u from 0 to 1 along that turn, the strip's intensity is c0 + α u + β u² at the
contour and c0 (1 - u) + c1 u + γ 4u(1 - u) between two faces: what light from afar on a dull surface gives to second
order. The strip is drawn in CELLS pieces of equal turn, each between its own two lines of the image; α, β, γ are held
near zero by a weak prior, because a strip seen too narrow does not show them.

The blur σ is that of the lens, and on every row also that of the motion: an edge that moves by m pixels across itself
during the exposure is spread by a box of variance m²/12. Marks, shadows and whatever hides the die are left to a
redescending weight (Tukey's biweight) whose scale comes from the residuals of the same stretch of edge, because the
grain on a die's faces is several times the noise of the still background.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R.
"""

from __future__ import annotations

from math import acos, ceil, cos, erf, exp, floor, hypot, log, sin, sqrt
from typing import Any

import numpy as np
from numba import njit

SEGMENT_PX = 24.0
"""Length of edge that shares its intensities: short enough for shading and shadow to be constant along it."""
BUFFER = 2048
"""Pixels of one such stretch at the most."""
CELLS = 5
"""Pieces of a rounded strip: with a radius of a few pixels each is narrower than the blur."""
STRIP_SHARE = 0.5
"""Standard deviation of the prior on α, β, γ, as a share of the mean intensity beside the edge."""
SLIVER = 0.04
"""Cosine below which a face is seen too much from the side for its edges to be told apart."""
TUKEY = 4.685
"""Cut of the biweight in sigmas: 95 % efficient on clean Gaussian residuals."""


@njit(cache=True)
def _project(K: Any, dist: Any, x: float, y: float, z: float, J: Any) -> tuple[float, float]:
    """Pixel of a camera point and, in J (2, 3), its derivative."""
    iz = 1.0 / z
    a, b = x * iz, y * iz
    k1, k2, p1, p2, k3 = dist[0], dist[1], dist[2], dist[3], dist[4]
    r2 = a * a + b * b
    g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dg = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    ad = a * g + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    bd = b * g + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    aa = g + 2.0 * a * a * dg + 2.0 * p1 * b + 6.0 * p2 * a
    ab = 2.0 * a * b * dg + 2.0 * p1 * a + 2.0 * p2 * b
    bb = g + 2.0 * b * b * dg + 6.0 * p1 * b + 2.0 * p2 * a
    ua, ub = K[0, 0] * aa + K[0, 1] * ab, K[0, 0] * ab + K[0, 1] * bb
    va, vb = K[1, 1] * ab, K[1, 1] * bb
    J[0, 0], J[0, 1], J[0, 2] = ua * iz, ub * iz, -(ua * a + ub * b) * iz
    J[1, 0], J[1, 1], J[1, 2] = va * iz, vb * iz, -(va * a + vb * b) * iz
    return K[0, 0] * ad + K[0, 1] * bd + K[0, 2], K[1, 1] * bd + K[1, 2]


@njit(cache=True)
def _factor(A: Any, K: int, L: Any) -> bool:
    """Cholesky factor of the leading K × K of A, in L; False where it is not positive definite."""
    for i in range(K):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if s <= 1e-9 * A[i, i]:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    return True


@njit(cache=True)
def _back(L: Any, K: int, y: Any, out: Any) -> None:
    """Solve L Lᵀ out = y."""
    for i in range(K):
        s = y[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        out[i] = s / L[i, i]
    for i in range(K - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, K):
            s -= L[k, i] * out[k]
        out[i] = s / L[i, i]


@njit(cache=True)
def _segment(
    n: int,
    K: int,
    phi: Any,
    slope: Any,
    base: float,
    grey: Any,
    row: Any,
    rows: Any,
    floor_grey: float,
    work: Any,
    H: Any,
    g: Any,
) -> tuple[float, float, float, float]:
    """Add one stretch of edge to the normal equations.

    `phi` (n, K) are the basis functions of the K intensities (near, far, and those of a rounded strip), `slope` (n, K)
    their derivatives by d, `base` the mean background on the far side (1 between two faces), `row` the index of the row
    of each pixel and `rows` (m, 6) the derivative of d by the pose. Returns the robust cost, the number of pixels that
    count, the contrast across the edge [grey] and the noise [grey].
    """
    if n < 12:
        return 0.0, 0.0, 0.0, 0.0
    w, res, size = work[0], work[1], work[2]
    for i in range(n):
        w[i] = 1.0
    scale = floor_grey
    A, L = np.zeros((4, 4)), np.zeros((4, 4))
    y, c = np.zeros(4), np.zeros(4)
    for turn_number in range(4):
        A[:] = 0.0
        y[:] = 0.0
        for i in range(n):
            for a in range(K):
                wa = w[i] * phi[i, a]
                y[a] += wa * grey[i]
                for b in range(a + 1):
                    A[a, b] += wa * phi[i, b]
        if K > 2:
            level = 0.5 * (abs(y[0] / max(A[0, 0], 1e-9)) + abs(y[1] / max(A[1, 1], 1e-9)) * base) + 1.0
            prior = (max(scale, 2.0) / (STRIP_SHARE * level)) ** 2
            for a in range(2, K):
                A[a, a] += prior
        if not _factor(A, K, L):
            return 0.0, 0.0, 0.0, 0.0
        _back(L, K, y, c)
        for i in range(n):
            res[i] = grey[i]
            for a in range(K):
                res[i] -= c[a] * phi[i, a]
            size[i] = abs(res[i])
        scale = max(floor_grey, 1.4826 * np.median(size[:n]))
        if turn_number < 3:
            for i in range(n):
                q = res[i] / (TUKEY * scale)
                w[i] = (1.0 - q * q) ** 2 if abs(q) < 1.0 else 0.0
    iv = 1.0 / (scale * scale)
    C = np.zeros((6, 4))
    cost, used = 0.0, 0.0
    for i in range(n):
        q = res[i] / (TUKEY * scale)
        cost += 1.0 if abs(q) >= 1.0 else 1.0 - (1.0 - q * q) ** 3
        used += w[i]
        if w[i] <= 0.0:
            continue
        rise = 0.0
        for a in range(K):
            rise += c[a] * slope[i, a]
        wi = w[i] * iv
        k = row[i]
        for a in range(6):
            ja = wi * rise * rows[k, a]
            g[a] += ja * res[i]
            for m in range(K):
                C[a, m] += ja * phi[i, m]
            for b in range(a + 1):
                H[a, b] += ja * rise * rows[k, b]
    # The intensities are eliminated: H -= C S⁻¹ Cᵀ, with S their own normal matrix, A / scale².
    for b in range(6):
        _back(L, K, C[b], y)
        for a in range(b, 6):
            s = 0.0
            for m in range(K):
                s += C[a, m] * y[m]
            H[a, b] -= s / iv
    return cost, used, abs(c[1] * base - c[0]), scale


@njit(cache=True)
def _strip_lines(aw: Any, n0: Any, n1: Any, interior: bool, radius: float, lines: Any) -> None:
    """Signed distances [px] of the CELLS + 1 lines of a rounded strip from the inner body's edge: the surface points
    whose normals divide the turn from n0 to n1, or to the contour, into equal parts. `aw` is the derivative of d by a
    world displacement."""
    size = sqrt(aw[0] * aw[0] + aw[1] * aw[1] + aw[2] * aw[2])
    along, across = 0.0, 0.0
    end = np.zeros(3)
    for a in range(3):
        end[a] = n1[a] if interior else aw[a] / size
    for a in range(3):
        along += n0[a] * end[a]
    angle = acos(min(1.0, max(-1.0, along)))
    for a in range(3):
        end[a] -= along * n0[a]
        across += end[a] * end[a]
    across = sqrt(max(across, 1e-30))
    d0, d1 = 0.0, 0.0
    for a in range(3):
        d0 += radius * aw[a] * n0[a]
        d1 += radius * aw[a] * end[a] / across
    for j in range(CELLS + 1):
        t = angle * j / CELLS
        lines[j] = d0 * cos(t) + d1 * sin(t)
    for j in range(1, CELLS + 1):
        lines[j] = max(lines[j], lines[j - 1])


@njit(cache=True)
def normal_equations(
    image: Any,
    background: Any,
    x0: int,
    y0: int,
    K: Any,
    dist: Any,
    Rcw: Any,
    tcw: Any,
    pos: Any,
    R: Any,
    vel: Any,
    omega: Any,
    exposure: float,
    vertices: Any,
    normals: Any,
    offsets: Any,
    edges: Any,
    edge_faces: Any,
    face_edges: Any,
    radius: float,
    sigma: float,
    band: float,
    floor_grey: float,
    work: Any,
    H: Any,
    g: Any,
    stats: Any,
) -> None:
    """Fill H (6, 6) and g (6,) of the pose increment, and `stats`.

    `image`, `background` are float32 windows whose pixel [0, 0] lies at (x0, y0). `vertices`, `normals`, `offsets` are
    those of the inner sharp body, `radius` [m] is the ball rolled round it. `stats` becomes: robust cost, pixels used,
    pixels seen, length of visible contour inside the image [px], length of it with a clear step, stretches used, and the
    sum over pixels of the logarithm of the noise left over, which the right blur makes smallest.
    """
    H[:] = 0.0
    g[:] = 0.0
    stats[:] = 0.0
    nv, ne, nf = vertices.shape[0], edges.shape[0], normals.shape[0]
    height, width = image.shape
    J = np.zeros((2, 3))
    r = np.zeros((nv, 3))
    cam = np.zeros((nv, 3))
    px = np.zeros((nv, 2))
    for i in range(nv):
        for a in range(3):
            r[i, a] = R[a, 0] * vertices[i, 0] + R[a, 1] * vertices[i, 1] + R[a, 2] * vertices[i, 2]
        for a in range(3):
            cam[i, a] = tcw[a]
            for b in range(3):
                cam[i, a] += Rcw[a, b] * (pos[b] + r[i, b])
        if cam[i, 2] <= 1e-6:
            return
        px[i, 0], px[i, 1] = _project(K, dist, cam[i, 0], cam[i, 1], cam[i, 2], J)
    centre = np.zeros(3)
    for a in range(3):
        for b in range(3):
            centre[a] -= Rcw[b, a] * tcw[b]
    nw = np.zeros((nf, 3))
    facing = np.zeros(nf)
    gap = 0.0
    for a in range(3):
        gap += (centre[a] - pos[a]) ** 2
    gap = sqrt(gap)
    for f in range(nf):
        s = -(offsets[f] + radius)
        for a in range(3):
            nw[f, a] = normals[f, 0] * R[a, 0] + normals[f, 1] * R[a, 1] + normals[f, 2] * R[a, 2]
        for a in range(3):
            s += nw[f, a] * (centre[a] - pos[a])
        facing[f] = s / gap
    grey = work[3]
    phi, slope = np.zeros((BUFFER, 4)), np.zeros((BUFFER, 4))
    lines = np.zeros(CELLS + 1)
    rowof = np.zeros(BUFFER, np.int64)
    rows = np.zeros((512, 6))
    aw = np.zeros(3)
    ac = np.zeros(3)
    D = np.zeros(3)
    for e in range(ne):
        f0, f1 = edge_faces[e, 0], edge_faces[e, 1]
        if facing[f0] <= 0.0 and facing[f1] <= 0.0:
            continue
        if facing[f0] <= 0.0:
            f0, f1 = f1, f0
        interior = facing[f1] > 0.0
        # A face seen at less than about 2 degrees is a sliver: its own edges lie within a pixel of each other and
        # neither can be told from the other.
        if facing[f0] < SLIVER or (interior and facing[f1] < SLIVER):
            continue
        iA, iB = edges[e, 0], edges[e, 1]
        ax, ay, bx, by = px[iA, 0], px[iA, 1], px[iB, 0], px[iB, 1]
        length = hypot(bx - ax, by - ay)
        if length < 6.0:
            continue
        steep = abs(by - ay) > abs(bx - ax)
        if steep:
            lo, hi = min(ay, by), max(ay, by)
        else:
            lo, hi = min(ax, bx), max(ax, bx)
        trim = (1.5 + 1.5 * sigma) * (hi - lo) / length
        first, last = ceil(lo + trim), floor(hi - trim)
        # Only what lies inside the window can be walked.
        if steep:
            first, last = max(first, y0), min(last, y0 + height - 1)
        else:
            first, last = max(first, x0), min(last, x0 + width - 1)
        if last - first < 2:
            continue
        # Middle of the near face, to give the edge normal its sign: d grows away from face f0.
        mx, my, count = 0.0, 0.0, 0
        for j in range(face_edges.shape[1]):
            o = face_edges[f0, j]
            if o < 0:
                break
            mx += px[edges[o, 0], 0] + px[edges[o, 1], 0]
            my += px[edges[o, 0], 1] + px[edges[o, 1], 1]
            count += 2
        mx /= count
        my /= count
        basis = 2 if radius == 0.0 else (3 if interior else 4)
        n = 0
        m = 0
        walked, under_sum = 0.0, 0.0
        for line in range(first, last + 1):
            lam = (line - ay) / (by - ay) if steep else (line - ax) / (bx - ax)
            s = lam * cam[iA, 2] / ((1.0 - lam) * cam[iB, 2] + lam * cam[iA, 2])
            X = cam[iA, 0] + s * (cam[iB, 0] - cam[iA, 0])
            Y = cam[iA, 1] + s * (cam[iB, 1] - cam[iA, 1])
            Z = cam[iA, 2] + s * (cam[iB, 2] - cam[iA, 2])
            u, v = _project(K, dist, X, Y, Z, J)
            for a in range(3):
                D[a] = cam[iB, a] - cam[iA, a]
            tx = J[0, 0] * D[0] + J[0, 1] * D[1] + J[0, 2] * D[2]
            ty = J[1, 0] * D[0] + J[1, 1] * D[1] + J[1, 2] * D[2]
            tl = hypot(tx, ty)
            nx, ny = ty / tl, -tx / tl
            if nx * (u - mx) + ny * (v - my) < 0.0:
                nx, ny = -nx, -ny
            for a in range(3):
                ac[a] = nx * J[0, a] + ny * J[1, a]
            for a in range(3):
                aw[a] = Rcw[0, a] * ac[0] + Rcw[1, a] * ac[1] + Rcw[2, a] * ac[2]
            rx = r[iA, 0] + s * (r[iB, 0] - r[iA, 0])
            ry = r[iA, 1] + s * (r[iB, 1] - r[iA, 1])
            rz = r[iA, 2] + s * (r[iB, 2] - r[iA, 2])
            qx, qy, qz = ry * aw[2] - rz * aw[1], rz * aw[0] - rx * aw[2], rx * aw[1] - ry * aw[0]
            if radius > 0.0:
                _strip_lines(aw, nw[f0], nw[f1], interior, radius, lines)
            low, high = min(lines[0], 0.0), max(lines[CELLS], 0.0)
            blur = sigma
            if exposure > 0.0:
                move = (
                    aw[0] * vel[0] + aw[1] * vel[1] + aw[2] * vel[2] + qx * omega[0] + qy * omega[1] + qz * omega[2]
                ) * exposure
                blur = sqrt(sigma * sigma + move * move / 12.0)
            inside, outside = band - low, band + high
            across = abs(ny) if not steep else abs(nx)
            # The band stops short of the other edges of the faces beside it.
            for side in range(2):
                if side == 1 and not interior:
                    break
                f = f0 if side == 0 else f1
                for j in range(face_edges.shape[1]):
                    o = face_edges[f, j]
                    if o < 0:
                        break
                    if o == e:
                        continue
                    cx, cy = px[edges[o, 0], 0], px[edges[o, 0], 1]
                    dx, dy = px[edges[o, 1], 0] - cx, px[edges[o, 1], 1] - cy
                    if steep:
                        if abs(dy) < 1e-9:
                            continue
                        k = (line - cy) / dy
                        away = abs(cx + k * dx - u) * across
                    else:
                        if abs(dx) < 1e-9:
                            continue
                        k = (line - cx) / dx
                        away = abs(cy + k * dy - v) * across
                    if k < -0.02 or k > 1.02:
                        continue
                    # The neighbour's own strip and blur reach out to meet us.
                    away -= 2.0 * blur
                    if side == 0:
                        inside = min(inside, away)
                    else:
                        outside = min(outside, away)
            if inside + low < 1.2 * blur or outside - high < 1.2 * blur:
                continue
            middle = u if steep else v
            # Along the pixel line the signed distance grows with slope `step`.
            step = nx if steep else ny
            if step > 0.0:
                begin, end = ceil(middle - inside / step), floor(middle + outside / step)
            else:
                begin, end = ceil(middle + outside / step), floor(middle - inside / step)
            offset = nx * (line - u) if not steep else ny * (line - v)
            # (line - u) or (line - v) is what the lens distortion leaves over; it shifts every pixel of the row alike.
            if steep:
                begin, end = max(begin, x0), min(end, x0 + width - 1)
            else:
                begin, end = max(begin, y0), min(end, y0 + height - 1)
            if end - begin < 2 or n + end - begin + 1 > BUFFER:
                continue
            rows[m, 0], rows[m, 1], rows[m, 2] = -aw[0], -aw[1], -aw[2]
            rows[m, 3], rows[m, 4], rows[m, 5] = -qx, -qy, -qz
            ib = 1.0 / (blur * sqrt(2.0))
            top = 1.0 / (blur * 2.5066282746310002)
            for q in range(begin, end + 1):
                if steep:
                    d = nx * (q - u) + offset
                    value = image[line - y0, q - x0]
                    under = background[line - y0, q - x0]
                else:
                    d = offset + ny * (q - v)
                    value = image[q - y0, line - x0]
                    under = background[q - y0, line - x0]
                shade = 1.0 if interior else under
                t = (d - lines[CELLS]) * ib
                a1 = 0.5 * (1.0 + erf(t))
                p1 = top * exp(-t * t)
                phi[n, 1], slope[n, 1] = a1 * shade, p1 * shade
                if radius > 0.0:
                    t = (d - lines[0]) * ib
                    a0 = 0.5 * (1.0 + erf(t))
                    p0 = top * exp(-t * t)
                    phi[n, 0], slope[n, 0] = 1.0 - a0, -p0
                    phi[n, 2], phi[n, 3], slope[n, 2], slope[n, 3] = 0.0, 0.0, 0.0, 0.0
                    for j in range(CELLS):
                        a2, p2 = a1, p1
                        if j + 1 < CELLS:
                            t = (d - lines[j + 1]) * ib
                            a2 = 0.5 * (1.0 + erf(t))
                            p2 = top * exp(-t * t)
                        cell, edge_of_cell = a0 - a2, p0 - p2
                        x = (j + 0.5) / CELLS
                        if interior:
                            phi[n, 0] += (1.0 - x) * cell
                            slope[n, 0] += (1.0 - x) * edge_of_cell
                            phi[n, 1] += x * cell
                            slope[n, 1] += x * edge_of_cell
                            phi[n, 2] += 4.0 * x * (1.0 - x) * cell
                            slope[n, 2] += 4.0 * x * (1.0 - x) * edge_of_cell
                        else:
                            phi[n, 0] += cell
                            slope[n, 0] += edge_of_cell
                            phi[n, 2] += x * cell
                            slope[n, 2] += x * edge_of_cell
                            phi[n, 3] += x * x * cell
                            slope[n, 3] += x * x * edge_of_cell
                        a0, p0 = a2, p2
                else:
                    phi[n, 0], slope[n, 0] = 1.0 - a1, -p1
                under_sum += shade
                grey[n] = value
                rowof[n] = m
                n += 1
            m += 1
            walked += length / (hi - lo)
            if m * length / (hi - lo) >= SEGMENT_PX or line == last:
                cost, used, contrast, scale = _segment(
                    n, basis, phi, slope, under_sum / max(n, 1), grey, rowof, rows, floor_grey, work, H, g,
                )  # fmt: skip
                stats[0] += cost
                stats[1] += used
                stats[2] += n
                stats[6] += n * log(scale) if scale > 0.0 else 0.0
                if not interior:
                    stats[3] += walked
                    if contrast > 3.0 * scale or (contrast > 1.0 * scale and used > 30):
                        stats[4] += walked
                stats[5] += 1.0
                n = 0
                m = 0
                walked, under_sum = 0.0, 0.0
        if m > 0:
            cost, used, contrast, scale = _segment(
                n, basis, phi, slope, under_sum / max(n, 1), grey, rowof, rows, floor_grey, work, H, g,
            )  # fmt: skip
            stats[0] += cost
            stats[1] += used
            stats[2] += n
            stats[6] += n * log(scale) if scale > 0.0 else 0.0
            if not interior:
                stats[3] += walked
                if contrast > 3.0 * scale or (contrast > 1.0 * scale and used > 30):
                    stats[4] += walked
            stats[5] += 1.0
    for a in range(6):
        for b in range(a):
            H[b, a] = H[a, b]


@njit(cache=True)
def _cholesky_solve(A: Any, y: Any, out: Any) -> bool:
    """Solve a symmetric positive definite system; False where it is not."""
    n = A.shape[0]
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if s <= 0.0:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(n):
        s = y[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        out[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, n):
            s -= L[k, i] * out[k]
        out[i] = s / L[i, i]
    return True


@njit(cache=True)
def turn(R: Any, w: Any) -> Any:
    """exp(w) R, by Rodrigues' formula; below 1e-8 rad the first-order form is exact to rounding."""
    angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -w[2], w[1], -w[0]
    W[1, 0], W[2, 0], W[2, 1] = w[2], -w[1], w[0]
    if angle < 1e-8:
        return R + W @ R
    E = np.eye(3) + sin(angle) / angle * W + (1.0 - cos(angle)) / (angle * angle) * (W @ W)
    return E @ R


@njit(cache=True)
def refine(
    image: Any,
    background: Any,
    x0: int,
    y0: int,
    K: Any,
    dist: Any,
    Rcw: Any,
    tcw: Any,
    pos: Any,
    R: Any,
    vel: Any,
    omega: Any,
    exposure: float,
    vertices: Any,
    normals: Any,
    offsets: Any,
    edges: Any,
    edge_faces: Any,
    face_edges: Any,
    radius: float,
    sigmas: Any,
    bands: Any,
    floor_grey: float,
    prior_position: float,
    prior_rotation: float,
    stats: Any,
) -> tuple[Any, Any, Any]:
    """Gauss-Newton from coarse to fine: one step for each entry of `sigmas` and `bands` [px].

    The prior is isotropic about the start: `prior_position` [m] and `prior_rotation` [rad] are its standard
    deviations. Returns position (3,), rotation (3, 3) and information (6, 6) of the pixels alone at the last step.
    """
    p = pos.copy()
    Q = R.copy()
    H = np.zeros((6, 6))
    g = np.zeros(6)
    work = np.zeros((4, BUFFER))
    away = np.zeros(6)
    step = np.zeros(6)
    A = np.zeros((6, 6))
    info = np.zeros((6, 6))
    wp, wr = 1.0 / prior_position**2, 1.0 / prior_rotation**2
    reach = 0.0
    for i in range(vertices.shape[0]):
        reach = max(reach, sqrt(vertices[i, 0] ** 2 + vertices[i, 1] ** 2 + vertices[i, 2] ** 2))
    for it in range(sigmas.shape[0]):
        normal_equations(
            image, background, x0, y0, K, dist, Rcw, tcw, p, Q, vel, omega, exposure, vertices, normals, offsets,
            edges, edge_faces, face_edges, radius, sigmas[it], bands[it], floor_grey, work, H, g, stats,
        )  # fmt: skip
        info[:] = H
        A[:] = H
        for a in range(6):
            w = wp if a < 3 else wr
            A[a, a] += w
            g[a] -= w * away[a]
        if not _cholesky_solve(A, g, step):
            info[:] = 0.0
            break
        # One step may move the die by a third of its reach or turn it by 8 degrees at the most: edges of other faces
        # come into the band beyond that.
        lp = sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        lr = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
        shrink = min(1.0, reach / 3.0 / max(lp, 1e-300), 0.14 / max(lr, 1e-300))
        for a in range(6):
            step[a] *= shrink
            away[a] += step[a]
        for a in range(3):
            p[a] += step[a]
        Q = turn(Q, step[3:])
        if it + 2 < sigmas.shape[0] and it >= 2 and sigmas[it] == sigmas[-1] and lp < 2e-7 and lr < 2e-5:
            break
    return p, Q, info


@njit(cache=True)
def region_score(
    image: Any,
    background: Any,
    noise: float,
    stride: int,
    planes: Any,
    count: Any,
    nf: int,
    cut: float,
    shadow_cut: float,
) -> tuple[float, float, float]:
    """How badly a drawn die explains a window, in truncated squared sigmas, summed over every stride-th pixel.

    `planes` (faces, corners, 3) are the half-planes a x + b y + c >= 0 of the visible faces in window pixels. Inside a
    face the image should be that face's mean grey; outside it should be the background, or a darker shade of it.
    Returns the sum, the number of pixels inside, and the share of those that differ from the background.
    """
    height, width = image.shape
    total = np.zeros(nf)
    number = np.zeros(nf)
    label = np.full((height // stride + 1, width // stride + 1), -1)
    for i in range(0, height, stride):
        for j in range(0, width, stride):
            for f in range(nf):
                ok = True
                for k in range(count[f]):
                    if planes[f, k, 0] * j + planes[f, k, 1] * i + planes[f, k, 2] < 0.0:
                        ok = False
                        break
                if ok:
                    label[i // stride, j // stride] = f
                    total[f] += image[i, j]
                    number[f] += 1.0
                    break
    mean = total / np.maximum(number, 1.0)
    # Marks pull the mean down: one more pass without what lies far below or above it.
    total[:] = 0.0
    number2 = np.zeros(nf)
    spread = 6.0 * noise
    for i in range(0, height, stride):
        for j in range(0, width, stride):
            f = label[i // stride, j // stride]
            if f >= 0 and abs(image[i, j] - mean[f]) < 2.0 * spread:
                total[f] += image[i, j]
                number2[f] += 1.0
    for f in range(nf):
        if number2[f] > 0.0:
            mean[f] = total[f] / number2[f]
    score, inside, differs = 0.0, 0.0, 0.0
    iv = 1.0 / (noise * noise)
    for i in range(0, height, stride):
        for j in range(0, width, stride):
            f = label[i // stride, j // stride]
            difference = image[i, j] - background[i, j]
            if f >= 0:
                inside += 1.0
                if abs(difference) > 3.0 * noise:
                    differs += 1.0
                e = image[i, j] - mean[f]
                grain = 4.0 * noise * noise + (0.04 * mean[f]) ** 2
                score += min(e * e / grain, cut)
            elif difference < 0.0:
                score += min(difference * difference * iv, shadow_cut)
            else:
                score += min(difference * difference * iv, cut)
    return score, inside, differs / max(inside, 1.0)
