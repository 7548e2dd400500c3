"""What the pixels say about the edges of a die: the normal equations of one pose, and the steps that solve them.

Every visible edge is walked along whole pixel rows or columns, each real pixel once and without interpolation, so that
the noise of neighbouring samples stays independent and the covariance honest. Across an edge, at signed distance d [px]
from its projection, the image is modelled as

    I(d) = c0 [1 - a] + c1 b a,      a = Φ(d / σ)

where c0 is the face on the near side and c1 the other face (b = 1), or the shade on the known background (b = B, the
background without the die: c1 = 1 in full light and less in the die's own shadow). The intensities of a short stretch
of edge are eliminated from the equations (variable projection), and no model of the light is needed. Where the stretches beside
one face of a sharp die, or beside the background, are much alike, each also knows the others' grey (`_share_greys`).

A rounded die is a smaller sharp body with a ball rolled round it. Its contour is that body's contour pushed out by the
radius, and what lies between a flat face and the contour, or between two flat faces, is a strip on which the surface
normal turns from one to the other. With u from 0 to 1 along that turn, the strip's intensity is c0 + α u + β u² at the
contour and c0 (1 - u) + c1 u + γ p(u) + δ q(u) between two faces, p = 4u(1 - u) and q the cubic that is nought at both ends
and in the middle: what light from afar on a dull surface gives to second order, and to third over the wider turn, which
passes through the light's direction and into the shade. The strip is drawn in CELLS pieces of equal turn, each between its own
two lines of the image; α, β, γ, δ are held near zero by a weak prior, because a strip seen too narrow does not show them.

Where the clip shows how bright a surface looks by where it turns (`light`), B(u) along the strip, c0 B(u)/B(0) takes the place of
c0, and the straight line between two faces is multiplied by B(u) over what lies straight between B(0) and B(1). α, β, γ, δ then
are no larger than what faces differ from B.

Where a clip has few grey levels, rounding to steps s wider than its noise errs alike on all pixels of one grey. The two greys
beside an edge are each off by s/√12, and the pixels between, which take all levels, by nothing in the mean: it is as if these
were off by e = s/√24 from the others, and the whole edge is shifted by e Σ|I'| / Σ I'², some 0.7 σ s/|c1 b - c0|. Its stretches
count for as much less as leaves the edge no surer than that.

The blur σ is that of the lens, and on every row also that of the motion: an edge that moves by m pixels across itself
during the exposure is spread by a box of variance m²/12, and what its path bends within the exposure T shifts its mean
place by T²/24 of the second derivative of d, which counts where the die turns by some hundredths of a radian. Marks and
shadows are left to a redescending weight (Tukey's biweight) whose scale comes from the residuals of the same stretch of
edge, because the grain on a die's faces is several times the noise of the still background.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R. Beside
them the equations have two columns that belong to a whole clip and not to a frame: the contour taken δ [px] too far out
(a bevel or a glare that the model does not know), and the blur. They are not solved for here; they say what such an error
does to the pose (`lean`), and let the blur be estimated over many frames.

What stands before the die (a rod, a frame) is in the background, and its borders look like contours of the die. Where a
pose well borne out puts the die before pixels that show the background and never change, the background becomes NaN, and
every row that touches it is left out: the pose is then as unsure as what is left makes it, and the motion carries it.

Several views add up their equations: cameras, and for a table that reflects, each camera seen in the mirror (its pose
times diag(1, 1, -1): the die's reflection is what the mirrored camera sees). Where the die and its reflection hide each
other, or one is the background of the other, the rows are left out.
"""

from __future__ import annotations

from math import ceil, floor, hypot, isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_no_memory
from .edge_stretch import add_stretch, eliminate
from .kernel_types import (
    BLUR,
    CURVED_PATH_PX,
    GRAZING_COSINE,
    LIGHT_TERMS,
    MAX_STRETCH_PIXELS,
    PARAMETERS,
    REFLECTION_MARGIN_PX,
    STRETCH_PX,
    STRIP_CELLS,
    CameraRig,
    FrameWindows,
    Shape,
    Workspace,
)
from .projection import neighbours, outline_hull, place_die, project_point, reach_of_die, room_beside, within_hull
from .rounded_edge import rounded_basis, sharp_basis, strip_lines, strip_shades, strip_turn


@inner_no_memory
def view_equations(
    view: int, windows: FrameWindows, backgrounds: Any, rig: CameraRig, shape: Shape, pos: Any, R: Any, vel: Any, omega: Any,
    exposure: float, sigma: float, band: float, stride: int, floor_grey: float, rounding_grey: float, strip_share: float,
    light: Any, full: bool, work: Workspace, H: Any, g: Any, stats: Any,
) -> None:  # fmt: skip
    """Add what one view says: H (8, 8, lower half) and g (8,) of pose, contour error and blur (the last only where
    `full`), and `stats`.

    `backgrounds` (cameras, height, width) float32 are whole pictures, NaN where something stands before the die; one pixel
    line in `stride` is used. `stats` counts: robust cost, pixels used, pixels seen, length of visible contour inside the
    image [px], length of it with a clear step, stretches used, and the sum over pixels of the logarithm of the noise left
    over.
    """
    hidden_by = 0
    if rig.partner[view] >= 0 and place_die(shape, rig, rig.partner[view], pos, R, work):
        hidden_by = outline_hull(shape, work)
    if not place_die(shape, rig, view, pos, R, work):
        return
    camera = rig.camera[view]
    image, background = windows.pixels[camera], backgrounds[camera]
    x0, y0 = windows.corner[camera, 0], windows.corner[camera, 1]
    x1, y1 = x0 + windows.size[camera, 0] - 1, y0 + windows.size[camera, 1] - 1
    K, dist, Rcw = rig.matrix[view], rig.distortion[view], rig.rotation[view]
    mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
    radius, sharp = shape.radius, shape.radius == 0.0
    px, cam, arm, J, aw, edges = work.px, work.cam, work.arm, work.J, work.across, shape.edges
    phi, slope, spread, grey, lines = work.phi, work.slope, work.spread, work.grey, work.lines
    near_edges, far_edges = work.beside[0], work.beside[1]
    hull, normal, rows, starts = work.hull, work.normal, work.rows, work.begin
    speed2 = omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2
    curved = speed2 * exposure * exposure / 24.0 * reach_of_die(shape) * K[0, 0] / cam[0, 2] > CURVED_PATH_PX
    lines[:] = 0.0
    strip_grey = light[view, LIGHT_TERMS + 1]
    work.shared[view] = 0.0
    work.by_shared[view] = 0.0
    work.pull[view] = 0.0
    for e in range(shape.edges.shape[0]):
        f0, f1 = shape.edge_faces[e, 0], shape.edge_faces[e, 1]
        if work.facing[f0] <= 0.0 and work.facing[f1] <= 0.0:
            continue
        if work.facing[f0] <= 0.0:
            f0, f1 = f1, f0
        interior = work.facing[f1] > 0.0
        # A face seen at less than about 2 degrees is a sliver: its own edges lie within a pixel of each other and
        # neither can be told from the other.
        if work.facing[f0] < GRAZING_COSINE or (interior and work.facing[f1] < GRAZING_COSINE):
            continue
        iA, iB = shape.edges[e, 0], shape.edges[e, 1]
        ax, ay, bx, by = px[iA, 0], px[iA, 1], px[iB, 0], px[iB, 1]
        length = hypot(bx - ax, by - ay)
        if length < 6.0:
            continue
        steep = abs(by - ay) > abs(bx - ax)
        lo, hi = (min(ay, by), max(ay, by)) if steep else (min(ax, bx), max(ax, bx))
        trim = ((1.0 + 1.2 * sigma) if sharp else (1.5 + 1.5 * sigma)) * (hi - lo) / length
        first, last = ceil(lo + trim), floor(hi - trim)
        # Only what lies inside the window can be walked.
        first, last = (max(first, y0), min(last, y1)) if steep else (max(first, x0), min(last, x1))
        if last - first < 2:
            continue
        # Middle of the near face, to give the edge normal its sign: d grows away from face f0.
        mx, my, count = 0.0, 0.0, 0
        for j in range(shape.face_edges.shape[1]):
            o = shape.face_edges[f0, j]
            if o < 0:
                break
            mx += px[shape.edges[o, 0], 0] + px[shape.edges[o, 1], 0]
            my += px[shape.edges[o, 0], 1] + px[shape.edges[o, 1], 1]
            count += 2
        mx /= count
        my /= count
        beside_near = neighbours(shape.face_edges[f0], edges, px, e, steep, near_edges)
        beside_far = neighbours(shape.face_edges[f1], edges, px, e, steep, far_edges)
        n = m = np.int64(0)
        walked, under_sum = 0.0, 0.0
        row_length = stride * length / (hi - lo)
        Ax, Ay, Az, Bz = cam[iA, 0], cam[iA, 1], cam[iA, 2], cam[iB, 2]
        Dx, Dy, Dz = cam[iB, 0] - Ax, cam[iB, 1] - Ay, Bz - Az
        Px, Py, Pz = arm[iA, 0], arm[iA, 1], arm[iA, 2]
        Qx, Qy, Qz = arm[iB, 0] - Px, arm[iB, 1] - Py, arm[iB, 2] - Pz
        for line in range(first, last + 1 + stride, stride):
            if m > 0 and (walked >= STRETCH_PX or line > last):
                if sharp:
                    sharp_basis(n, phi[0], phi[1], slope[0], slope[1])
                    if full:
                        for j in range(n):
                            spread[0, j], spread[1, j] = -slope[0, j] * spread[0, j], -slope[1, j] * spread[0, j]
                add_stretch(
                    work, n, m, sharp, interior, under_sum, walked, floor_grey, rig.weight[view],
                    rounding_grey, strip_share, strip_grey, (last - first + 1) / (stride * m), full, view,
                    f0, f1 if interior else len(work.facing), H, g, stats,
                )  # fmt: skip
                n = m = np.int64(0)
                walked, under_sum = 0.0, 0.0
            if line > last:
                break
            lam = (line - ay) / (by - ay) if steep else (line - ax) / (bx - ax)
            s = lam * Az / ((1.0 - lam) * Bz + lam * Az)
            u, v = project_point(K, dist, Ax + s * Dx, Ay + s * Dy, Az + s * Dz, J)
            tx = J[0, 0] * Dx + J[0, 1] * Dy + J[0, 2] * Dz
            ty = J[1, 0] * Dx + J[1, 1] * Dy + J[1, 2] * Dz
            tl = sqrt(tx * tx + ty * ty)
            nx, ny = ty / tl, -tx / tl
            if nx * (u - mx) + ny * (v - my) < 0.0:
                nx, ny = -nx, -ny
            a0, a1, a2 = nx * J[0, 0] + ny * J[1, 0], nx * J[0, 1] + ny * J[1, 1], nx * J[0, 2] + ny * J[1, 2]
            for a in range(3):
                aw[a] = Rcw[0, a] * a0 + Rcw[1, a] * a1 + Rcw[2, a] * a2
            rx, ry, rz = Px + s * Qx, Py + s * Qy, Pz + s * Qz
            qx, qy, qz = ry * aw[2] - rz * aw[1], rz * aw[0] - rx * aw[2], rx * aw[1] - ry * aw[0]
            if not sharp:
                angle = strip_turn(aw, normal[f0], normal[f1], interior, work.turned)
                strip_lines(aw, normal[f0], work.turned, angle, radius, lines)
                if m == 0:
                    strip_shades(light[view], normal[f0], work.turned, angle, interior, work.strip)
            low, high = min(lines[0], 0.0), max(lines[STRIP_CELLS], 0.0)
            blur, bend = sigma, 0.0
            if exposure > 0.0:
                move = (
                    aw[0] * vel[0] + aw[1] * vel[1] + aw[2] * vel[2] + qx * omega[0] + qy * omega[1] + qz * omega[2]
                ) * exposure
                blur = sqrt(sigma * sigma + move * move / 12.0)
                if curved:
                    bend = _bend(J, Rcw, nx, ny, rx, ry, rz, Qx, Qy, Qz, vel, omega) * exposure * exposure / 24.0
            across, middle = (abs(nx), u) if steep else (abs(ny), v)
            # The band stops short of the other edges of the faces beside it, and of their own strip and blur.
            inside = min(band - low, room_beside(near_edges, beside_near, line, middle) * across - 2.0 * blur)
            outside = band + high
            if interior:
                outside = min(outside, room_beside(far_edges, beside_far, line, middle) * across - 2.0 * blur)
            if inside + low < 1.2 * blur or outside - high < 1.2 * blur:
                continue
            if hidden_by > 0 and (mirrored or not interior):
                reach = high + 2.0 * blur
                if within_hull(hull, hidden_by, u, v, REFLECTION_MARGIN_PX + reach):
                    continue
            # Along the pixel line the signed distance grows with slope `step`.
            step = nx if steep else ny
            if step > 0.0:
                begin, end = ceil(middle - inside / step), floor(middle + outside / step)
            else:
                begin, end = ceil(middle + outside / step), floor(middle - inside / step)
            begin, end = (max(begin, x0), min(end, x1)) if steep else (max(begin, y0), min(end, y1))
            if end - begin < 2 or n + end - begin + 1 > MAX_STRETCH_PIXELS:
                continue
            # (line - u) or (line - v) is what the lens distortion leaves over; it shifts every pixel of the row alike.
            d = step * (begin - middle) + (ny * (line - v) if steep else nx * (line - u)) + bend
            ib = 1.0 / blur
            under_row = 0.0
            i = n
            for q in range(begin, end + 1):
                if steep:
                    value, under = image[line - y0, q - x0], background[line, q]
                else:
                    value, under = image[q - y0, line - x0], background[q, line]
                under_row += under
                shade = 1.0 if interior else float(under)
                if sharp:
                    phi[0, i], phi[1, i], slope[0, i] = d * ib, shade, ib
                    if full:
                        # The row's blur grows with the lens blur by σ / blur.
                        spread[0, i] = d * ib * sigma * ib
                else:
                    rounded_basis(d, ib, shade, work.strip, lines, full, phi, slope, spread, i)
                grey[i] = value
                d += step
                i += 1
            if isnan(under_row):
                continue
            if full and not sharp:
                for a in range(4):
                    for j in range(n, i):
                        spread[a, j] *= sigma * ib
            rows[m, 0], rows[m, 1], rows[m, 2] = -aw[0], -aw[1], -aw[2]
            rows[m, 3], rows[m, 4], rows[m, 5] = -qx, -qy, -qz
            # A contour taken δ too far out has every pixel δ nearer to the die.
            rows[m, 6] = 0.0 if interior else -1.0
            starts[m] = n
            under_sum += float(i - n) if interior else under_row
            n = i
            m += 1
            starts[m] = n
            walked += row_length
    if sharp:
        eliminate(work, view, PARAMETERS if full else BLUR, H, g)


@inner_no_memory
def _bend(
    J: Any, Rcw: Any, nx: float, ny: float, rx: float, ry: float, rz: float, Qx: float, Qy: float, Qz: float, vel: Any,
    omega: Any,
) -> float:  # fmt: skip
    """Second derivative by time [px/s²] of a pixel's signed distance d = n (p - e) from a moving edge, e its point there:
    2 φ' (t · e') - n · e'', with φ' the rate at which the edge's direction t turns in the picture. Of the point's
    acceleration only ω × (ω × r) counts; gravity moves it by nanometres within an exposure."""
    wx, wy, wz = omega[0], omega[1], omega[2]
    vx, vy, vz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    cx, cy, cz = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    ex, ey, ez = wy * Qz - wz * Qy, wz * Qx - wx * Qz, wx * Qy - wy * Qx
    vx, vy, vz = vx + vel[0], vy + vel[1], vz + vel[2]
    along, across, turning, length, falling = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        # Normal and tangent (-ny, nx) of the edge, as derivatives by a world displacement along axis k.
        x = J[0, 0] * Rcw[0, k] + J[0, 1] * Rcw[1, k] + J[0, 2] * Rcw[2, k]
        y = J[1, 0] * Rcw[0, k] + J[1, 1] * Rcw[1, k] + J[1, 2] * Rcw[2, k]
        normal, tangent = nx * x + ny * y, nx * y - ny * x
        vk, ck, ek, qk = (vx, cx, ex, Qx) if k == 0 else ((vy, cy, ey, Qy) if k == 1 else (vz, cz, ez, Qz))
        along += tangent * vk
        across += normal * vk
        falling += normal * ck
        turning += normal * ek
        length += tangent * qk
    return 2.0 * turning / length * along - falling
