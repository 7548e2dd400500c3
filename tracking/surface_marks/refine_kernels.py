"""tracking.surface_marks.refine_kernels."""

from __future__ import annotations

from math import hypot
from typing import Any

import numpy as np

from ...model.compiled import compiled
from ..picture import solve_positive
from .face_geometry import moved_px, turned_by
from .kernel_types import MOST, NO_PLACES, OVERSTEP, POSE, SETTLED_PX, Faces, Optics, new_bench
from .mark_equations import mark_equations


@compiled(nogil=True)
def refine_on_marks(
    frames: Any, which: Any, boxes: Any, optics: Optics, faces: Faces, positions: Any, rotations: Any, velocities: Any,
    omegas: Any, factor: float, others: Any, other_gs: Any, steps: int, H: Any,
) -> None:  # fmt: skip
    """Gauss-Newton on the marks together with another source of the pose, on frames number `which` (m,) of many
    (n, cameras, height, width), whose first camera's windows are `boxes` (m, 4; x0, y0, x1, y1), empty where a frame shall be
    left alone.

    `others` (m, 6, 6) is that source's information and `other_gs` (m, 6) its information times its pose minus the start;
    `factor` divides the information of the marks. `positions` (m, 3) and `rotations` (m, 3, 3) are replaced; H (m, 6, 6)
    becomes the information of the marks alone, divided by `factor`; zero where no face with marks is seen, whose pose stays.
    """
    K, Rcw, tcw = optics.matrix, optics.rotation, optics.translation
    reach = hypot(faces.offsets[0], hypot(faces.corners[0, 0, 0], faces.corners[0, 0, 1]))
    place, stats = np.zeros((1, 1, 1)), np.zeros((faces.axes.shape[0], 3))
    Hk, g = np.zeros((6, 6)), np.zeros(6)
    A, y, step, away = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6)
    bench = new_bench(MOST, faces.coefficients.shape[1])
    for k in range(which.shape[0]):
        x0, y0 = boxes[k, 0], boxes[k, 1]
        if boxes[k, 2] <= x0 or boxes[k, 3] <= y0:
            continue
        image = np.empty((boxes[k, 3] - y0, boxes[k, 2] - x0), np.float32)
        for i in range(image.shape[0]):
            here, there = image[i], frames[which[k], 0, y0 + i, x0:]
            for j in range(image.shape[1]):
                here[j] = there[j]
        p, Q, vel, omega = positions[k].copy(), rotations[k].copy(), velocities[k], omegas[k]
        other, other_g = others[k], other_gs[k]
        seen = False
        away[:] = 0.0
        for _ in range(steps):
            mark_equations(image, x0, y0, optics, faces, p, Q, vel, omega, NO_PLACES, bench, Hk, g, place, stats)
            seen = Hk[0, 0] > 0.0
            if not seen:
                break
            for i in range(6):
                y[i] = g[i] / factor + other_g[i]
                for j in range(6):
                    Hk[i, j] /= factor
                    A[i, j] = Hk[i, j] + other[i, j]
                    y[i] -= other[i, j] * away[j]
            for i in range(6):
                # Columns of metres and of radians: the pivots are judged relative to their own diagonal.
                A[i, i] *= 1.0 + 1e-12
            seen = solve_positive(A, POSE, y, step)
            if not seen:
                break
            gained = 0.0
            for i in range(6):
                gained += step[i] * y[i]
                step[i] *= OVERSTEP
                away[i] += step[i]
            for i in range(3):
                p[i] += step[i]
            Q = turned_by(Q, step[3:])
            # A third of a sigma moved: the next step would be a tenth of that.
            if gained < 0.1 or moved_px(K, Rcw, tcw, p, step, reach) < SETTLED_PX:
                break
        for i in range(6):
            for j in range(6):
                H[k, i, j] = Hk[i, j] if seen else 0.0
        if seen:
            for i in range(3):
                positions[k, i] = p[i]
                for j in range(3):
                    rotations[k, i, j] = Q[i, j]
