"""The edges of a die in one view: normal equations of one pose.

Every visible edge is sampled along whole pixel rows or columns, each real pixel once and without interpolation, so that
the noise of neighbouring samples stays independent and the covariance honest. Across an edge, at signed distance d [px]
from its projection, the image is modelled as

    I(d) = c0 [1 - a] + c1 b a,      a = Φ(d / σ)

where c0 is the face on the near side and c1 the other face (b = 1), or the shade on the known background (b = B, the
background without the die: c1 = 1 in full light and less in the die's own shadow). The intensities of a short stretch
of edge are eliminated (`edge_stretch`); the strips beside a rounded edge have two more (`rounded_edge`). Beside a contour the
shade has a slope, too, since the shadow of a die is soft.

The blur σ is that of the lens (at the depth of the edge, where the lens shows a depth of field), and on every pixel line
also that of the motion. An edge that moves by m pixels across itself during the exposure is spread by a box of variance
m²/12. The curvature of its path within the exposure T shifts its mean position by T²/24 of the second derivative of d,
which matters where the die turns by some hundredths of a radian.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R. The
equations have three more columns, which belong to a whole clip and not to a frame: the contour drawn δ [px] too far out
(a bevel or a glare that the model does not know), the blur, and the exponent of the camera's response. They are not
solved for here. The first and the last give the bias of the pose that such an error leaves (`bias_jacobians`), the blur
is estimated over many frames.

Several views add up their equations: cameras, and for a table that reflects, each camera seen in the mirror (its pose
times diag(1, 1, -1): the die's reflection is what the mirrored camera sees). Lines where the die and its reflection
hide each other, or where one is the background of the other, are left out, and so are lines that touch an occluder
(`occluders`).

With a rolling shutter every pixel row shows the die at its own instant (`projection`). On a pixel line that is a row
the edge is that of the moved die. On a column the edge also moves from pixel to pixel: with the rate ḋ of the signed
distance, d changes by ∂d/∂v + ḋ τ per pixel, τ being the time from row to row.
"""

from __future__ import annotations

from math import ceil, floor, hypot, isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner, inner_no_memory
from ..placed_die import (
    CONTOUR,
    MAX_STRETCH_PIXELS,
    NO_LIGHT,
    STRIP_CELLS,
    EdgeSampling,
    FrameWindows,
    NormalEquations,
    PictureModel,
    PoseState,
    Workspace,
    camera_point,
    clear_light,
    defocus_variance,
    depth_of,
    eliminate_light,
    exposure_delay,
    fill_rounded_basis,
    fill_sharp_basis,
    fill_strip_lines,
    fill_strip_rows,
    fill_strip_slopes,
    neighbour_edges,
    outline_hull,
    place_die,
    project_point,
    reach_of_die,
    room_beside,
    strip_turn,
    turned_within,
    used_columns,
    within_hull,
)
from .edge_stretch import Stretch, add_stretch, eliminate_shared_greys
from .shade import shade_slope

STRETCH_PX = 24.0
"""Length of edge that shares its intensities: short enough for shading to be constant along it."""
SHADED_STRETCH_PX = 8.0
"""The same of contour where a pose near by is refined, for the die's own shadow lies beside a part of an edge: distances of
an icosahedron of 26 px an edge were off by 0.2 mm instead of 1.2. With longer stretches, whose noise is surer, tracking follows
dice that it loses with short ones."""
SHORTEST_EDGE_PX = 6.0
"""A shorter edge has too few pixels between its trimmed ends."""
TRIM_PX = 1.0
"""Length left out at either end of an edge, where the next edge blurs into it."""
TRIM_BLURS = 1.2
"""The same per pixel of blur."""
ROUNDED_TRIM_PX = 1.5
ROUNDED_TRIM_BLURS = 1.5
"""The same for rounded dice, whose corners are balls."""
CURVED_PATH_PX = 0.005
"""Displacement of an edge by the curvature of its path within the exposure from which on that is computed."""
GRAZING_COSINE = 0.04
"""Cosine, of about 2 degrees, below which a face is a sliver: its edges lie within a pixel of each other and cannot be
separated."""
REFLECTION_MARGIN_PX = 2.0
"""Margin about the outline of a reflection (or of the die before its reflection) within which lines are left out."""
KEPT_BLURS = 2.0
"""Blurs by which the band stays away from other edges."""
LEAST_BAND_BLURS = 1.2
"""A band that reaches less far to either side, in blurs, does not show both intensities."""


@inner(nogil=True, _nrt=False, shared=True)
def add_edge_equations(
    view: int, windows: FrameWindows, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add the edges of one view to the normal equations, H (lower half) and g, and to the statistics."""
    rig, shape, settings = model.rig, model.shape, model.settings
    vel, omega, exposure = pose.velocity, pose.omega, settings.exposure_s
    row_s, middle_row, late = rig.row_s[view], rig.middle_row[view], exposure_delay(rig, pose.position)
    H, g, stride = equations.H, equations.g, settings.line_stride
    sigma, band, with_blur = sampling.blur_px, sampling.band_px, sampling.with_blur
    hidden_by = 0
    if rig.partner[view] >= 0 and place_die(shape, rig, rig.partner[view], pose, work):
        hidden_by = outline_hull(shape, work)
    if not place_die(shape, rig, view, pose, work):
        return
    camera = rig.camera[view]
    image, background = windows.pixels[camera], model.backgrounds[camera]
    x0, y0 = windows.corner[camera, 0], windows.corner[camera, 1]
    x1, y1 = x0 + windows.size[camera, 0] - 1, y0 + windows.size[camera, 1] - 1
    K, dist, Rcw = rig.matrix[view], rig.distortion[view], rig.rotation[view]
    mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
    radius, sharp = shape.radius, shape.radius == 0.0
    same_band = not sharp and work.light.level[view] == NO_LIGHT
    px, cam, arm, J, aw, edges = (
        work.vertex_px,
        work.vertex_camera,
        work.vertex_arm,
        work.J,
        work.edge_gradient,
        shape.edges,
    )
    phi, slope, spread, grey, lines = work.basis, work.basis_slope, work.basis_blur, work.grey, work.strip_lines
    near_edges, far_edges = work.neighbours[0], work.neighbours[1]
    hull, normal, rows, row_begin, facing = (
        work.hull,
        work.face_normal,
        work.row_jacobian,
        work.row_begin,
        work.face_cosine,
    )
    aperture, focus, centre2 = rig.aperture[view], rig.focus[view], 0.0
    if aperture > 0.0:
        centre2 = defocus_variance(aperture, focus, K[0, 0], depth_of(rig, view, pose.position))
    speed2 = omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2
    curved = speed2 * exposure * exposure / 24.0 * reach_of_die(shape) * K[0, 0] / cam[0, 2] > CURVED_PATH_PX
    lines[:] = 0.0
    work.shared_matrix[view] = 0.0
    work.shared_coupling[view] = 0.0
    work.shared_right[view] = 0.0
    if not sharp:
        clear_light(view, work.light)
    for e in range(shape.edges.shape[0]):
        f0, f1 = shape.edge_faces[e, 0], shape.edge_faces[e, 1]
        if facing[f0] <= 0.0 and facing[f1] <= 0.0:
            continue
        if facing[f0] <= 0.0:
            f0, f1 = f1, f0
        interior = facing[f1] > 0.0
        if facing[f0] < GRAZING_COSINE or (interior and facing[f1] < GRAZING_COSINE):
            continue
        iA, iB = shape.edges[e, 0], shape.edges[e, 1]
        ax, ay, bx, by = px[iA, 0], px[iA, 1], px[iB, 0], px[iB, 1]
        length = hypot(bx - ax, by - ay)
        if length < SHORTEST_EDGE_PX:
            continue
        steep = abs(by - ay) > abs(bx - ax)
        lo, hi = (min(ay, by), max(ay, by)) if steep else (min(ax, bx), max(ax, bx))
        trim_px = (TRIM_PX + TRIM_BLURS * sigma) if sharp else (ROUNDED_TRIM_PX + ROUNDED_TRIM_BLURS * sigma)
        trim = trim_px * (hi - lo) / length
        first, last = ceil(lo + trim), floor(hi - trim)
        # Only pixel lines within the window exist.
        first, last = (max(first, y0), min(last, y1)) if steep else (max(first, x0), min(last, x1))
        if last - first < 2:
            continue
        # The middle of the near face gives the edge normal its sign: d grows away from face f0.
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
        beside_near = neighbour_edges(shape.face_edges[f0], edges, px, e, steep, near_edges)
        beside_far = neighbour_edges(shape.face_edges[f1], edges, px, e, steep, far_edges)
        n = m = np.int64(0)
        walked, under_sum = 0.0, 0.0
        row_length = stride * length / (hi - lo)
        height = pose.position[2] + 0.5 * (arm[iA, 2] + arm[iB, 2])
        slope_of_shade = shade_slope(model, view, pose.position, height)
        Ax, Ay, Az, Bz = cam[iA, 0], cam[iA, 1], cam[iA, 2], cam[iB, 2]
        Dx, Dy, Dz = cam[iB, 0] - Ax, cam[iB, 1] - Ay, Bz - Az
        Px, Py, Pz = arm[iA, 0], arm[iA, 1], arm[iA, 2]
        Qx, Qy, Qz = arm[iB, 0] - Px, arm[iB, 1] - Py, arm[iB, 2] - Pz
        for line in range(first, last + 1 + stride, stride):
            if m > 0 and (walked >= (STRETCH_PX if interior else settings.contour_stretch_px) or line > last):
                if sharp:
                    fill_sharp_basis(n, phi[0], phi[1], slope[0], slope[1], work.ramp)
                    if with_blur:
                        for j in range(n):
                            spread[0, j], spread[1, j] = -slope[0, j] * spread[0, j], -slope[1, j] * spread[0, j]
                stretch = Stretch(
                    n, m, sharp, interior, under_sum, walked, (last - first + 1) / (stride * m), rig.weight[view], view, f0,
                    f1 if interior else len(facing), slope_of_shade,
                )  # fmt: skip
                add_stretch(stretch, settings, sampling, work, equations)
                n = m = np.int64(0)
                walked, under_sum = 0.0, 0.0
            if line > last:
                break
            # The point of the edge on this pixel line, at a share `s` of the edge in space.
            lam = (line - ay) / (by - ay) if steep else (line - ax) / (bx - ax)
            s = lam * Az / ((1.0 - lam) * Bz + lam * Az)
            rx, ry, rz = Px + s * Qx, Py + s * Qy, Pz + s * Qz
            # Point and direction of the edge when the row is exposed: rotated by ω dt from those at the pose.
            arm_then, edge_then, dt, row = (rx, ry, rz), (Qx, Qy, Qz), 0.0, 0.0
            gx, gy, gz = Dx, Dy, Dz
            if row_s == 0.0:
                u, v = project_point(K, dist, Ax + s * Dx, Ay + s * Dy, Az + s * Dz, J)
            else:
                row = float(line) if steep else ay + lam * (by - ay)
                dt = (row - middle_row) * row_s - late
                x, y, z = camera_point(rig, view, pose, arm_then, dt)
                u, v = project_point(K, dist, x, y, z, J)
                arm_then = turned_within(omega, dt, rx, ry, rz)
                edge_then = turned_within(omega, dt, Qx, Qy, Qz)
                ex, ey, ez = edge_then
                gx = Rcw[0, 0] * ex + Rcw[0, 1] * ey + Rcw[0, 2] * ez
                gy = Rcw[1, 0] * ex + Rcw[1, 1] * ey + Rcw[1, 2] * ez
                gz = Rcw[2, 0] * ex + Rcw[2, 1] * ey + Rcw[2, 2] * ez
            tx = J[0, 0] * gx + J[0, 1] * gy + J[0, 2] * gz
            ty = J[1, 0] * gx + J[1, 1] * gy + J[1, 2] * gz
            tl = sqrt(tx * tx + ty * ty)
            nx, ny = ty / tl, -tx / tl
            if nx * (u - mx) + ny * (v - my) < 0.0:
                nx, ny = -nx, -ny
            a0, a1, a2 = nx * J[0, 0] + ny * J[1, 0], nx * J[0, 1] + ny * J[1, 1], nx * J[0, 2] + ny * J[1, 2]
            for a in range(3):
                aw[a] = Rcw[0, a] * a0 + Rcw[1, a] * a1 + Rcw[2, a] * a2
            ax_then, ay_then, az_then = aw[0], aw[1], aw[2]
            if row_s != 0.0:
                # As seen from the axes at the pose, to which rotations and face normals belong.
                aw[0], aw[1], aw[2] = turned_within(omega, -dt, aw[0], aw[1], aw[2])
            qx, qy, qz = ry * aw[2] - rz * aw[1], rz * aw[0] - rx * aw[2], rx * aw[1] - ry * aw[0]
            if not sharp:
                angle = strip_turn(aw, normal[f0], normal[f1], interior, work.strip_end)
                fill_strip_lines(aw, normal[f0], work.strip_end, angle, radius, lines)
                if m == 0 and work.light.level[view] > 0.0:
                    fill_strip_rows(normal[f0], work.strip_end, angle, interior, work.light.mean[view], work.light)
                fill_strip_slopes(interior, work.light.left, work)
            lens2, bend, rate = sigma * sigma, 0.0, 0.0
            if aperture > 0.0:
                # The blur at this point of the edge, and not at the depth of the centre.
                lens2 += defocus_variance(aperture, focus, K[0, 0], Az + s * Dz) - centre2
            blur = sqrt(lens2)
            if exposure > 0.0 or row_s != 0.0:
                rate = (
                    ax_then * vel[0]
                    + ay_then * vel[1]
                    + az_then * vel[2]
                    + qx * omega[0]
                    + qy * omega[1]
                    + qz * omega[2]
                )
            if exposure > 0.0:
                move = rate * exposure
                blur = sqrt(lens2 + move * move / 12.0)
                if curved:
                    bend = _distance_acceleration(J, Rcw, (nx, ny), arm_then, edge_then, vel, omega)
                    bend = bend * exposure * exposure / 24.0
            across, middle = (abs(nx), u) if steep else (abs(ny), v)
            # The band stops short of the blur of the other edges of the faces beside it. The flat part of a face is the inner
            # body's, moved out: its other edges lie as far from the first or last line of the strip. Where radii are compared,
            # all shall see the same pixels.
            before, behind = lines[0], lines[STRIP_CELLS]
            moved, moved_far = (0.0, 0.0) if same_band else (before, behind)
            room = room_beside(near_edges, beside_near, line, middle) * across
            inside = min(band - min(before, 0.0), room - KEPT_BLURS * blur - moved)
            outside = band + max(behind, 0.0)
            if interior:
                room = room_beside(far_edges, beside_far, line, middle) * across
                outside = min(outside, room - KEPT_BLURS * blur + moved_far)
            least = LEAST_BAND_BLURS * blur
            if inside + min(before, moved) < least or outside - behind < least:
                continue
            if hidden_by > 0 and (mirrored or not interior):
                reach = max(lines[STRIP_CELLS], 0.0) + KEPT_BLURS * blur
                if within_hull(hull, hidden_by, u, v, REFLECTION_MARGIN_PX + reach):
                    continue
            # Along the pixel line the signed distance grows with slope `step`.
            step = nx if steep else ny - rate * row_s
            if step > 0.0:
                begin, end = ceil(middle - inside / step), floor(middle + outside / step)
            else:
                begin, end = ceil(middle + outside / step), floor(middle - inside / step)
            begin, end = (max(begin, x0), min(end, x1)) if steep else (max(begin, y0), min(end, y1))
            if end - begin < 2 or n + end - begin + 1 > MAX_STRETCH_PIXELS:
                continue
            # Lens distortion leaves a remainder (line - u) or (line - v), which shifts every pixel of the line alike.
            d = step * (begin - middle) + (ny * (line - v) if steep else nx * (line - u)) + bend
            if row_s != 0.0 and not steep:
                d -= rate * row_s * (v - row)
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
                work.value[i] = value
                if sharp:
                    phi[0, i], phi[1, i], slope[0, i] = d * ib, shade, ib
                    if with_blur:
                        # The blur of the line grows with the lens blur by σ / blur.
                        spread[0, i] = d * ib * sigma * ib
                    grey[i] = value
                else:
                    grey[i] = value - fill_rounded_basis(d, blur, shade, with_blur, work, i)
                d += step
                i += 1
            if isnan(under_row):
                continue
            if with_blur and not sharp:
                for a in range(4):
                    for j in range(n, i):
                        spread[a, j] *= sigma * ib
            rows[m, 0], rows[m, 1], rows[m, 2] = -ax_then, -ay_then, -az_then
            rows[m, 3], rows[m, 4], rows[m, 5] = -qx, -qy, -qz
            # A contour drawn δ too far out brings every pixel δ nearer to the die.
            rows[m, CONTOUR] = 0.0 if interior else -1.0
            row_begin[m] = n
            under_sum += float(i - n) if interior else under_row
            n = i
            m += 1
            row_begin[m] = n
            walked += row_length
    top = used_columns(sampling)
    if sharp:
        eliminate_shared_greys(work, view, top, H, g)
    else:
        eliminate_light(work.light, view, top, H, g)


@inner_no_memory
def _distance_acceleration(J: Any, Rcw: Any, normal: Any, arm: Any, edge: Any, vel: Any, omega: Any) -> float:
    """Second derivative by time [px/s²] of a pixel's signed distance d = n (p - e) from a moving edge, e its point
    there.

    It is 2 φ' (t · e') - n · e'', with φ' the rate at which the edge's direction t turns in the picture. Of the
    acceleration of the point only ω × (ω × r) counts; gravity moves it by nanometres within an exposure. `normal` is n,
    `arm` is r [m] and `edge` the vector along the edge [m], the last two in world axes.
    """
    (nx, ny), (rx, ry, rz), (Qx, Qy, Qz) = normal, arm, edge
    wx, wy, wz = omega[0], omega[1], omega[2]
    vx, vy, vz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    cx, cy, cz = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    ex, ey, ez = wy * Qz - wz * Qy, wz * Qx - wx * Qz, wx * Qy - wy * Qx
    vx, vy, vz = vx + vel[0], vy + vel[1], vz + vel[2]
    along, turning, length, falling = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        # Normal and tangent (-ny, nx) of the edge, as derivatives by a world displacement along axis k.
        x = J[0, 0] * Rcw[0, k] + J[0, 1] * Rcw[1, k] + J[0, 2] * Rcw[2, k]
        y = J[1, 0] * Rcw[0, k] + J[1, 1] * Rcw[1, k] + J[1, 2] * Rcw[2, k]
        by_normal, by_tangent = nx * x + ny * y, nx * y - ny * x
        vk, ck, ek, qk = (vx, cx, ex, Qx) if k == 0 else ((vy, cy, ey, Qy) if k == 1 else (vz, cz, ez, Qz))
        along += by_tangent * vk
        falling += by_normal * ck
        turning += by_normal * ek
        length += by_tangent * qk
    return 2.0 * turning / length * along - falling
