"""The spin of a symmetric die that turns far from one frame to the next.

A die that turns by more than half its symmetry from one frame to the next looks as if it turned otherwise: a dodecahedron by 66
degrees as one by less than 37 about another axis. But only in its true labelling it turns evenly, since the other axes turn with
the die. Two frames allow as many spins as the die has labellings, and the third rejects all but one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.die import nearest_equivalent_rotation
from ...model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from ..flights import left_jacobians

Array = NDArray[np.float64]

SAME_DEPARTURE = 1.1
"""Factor on the least departure from an even rotation within which others count as even: the slowest of them is taken. About an
axis of symmetry several spins turn a die through the same orientations."""
UNEVEN_RAD = np.radians(10.0)
"""Departure [rad] from an even rotation by which labels are surely wrong: single poses err by a few degrees."""
LEAST_DEPARTURE_RAD = 1e-6
"""Departure [rad] up to which all count as even."""


def even_rotation(
    rotations: Array, times_s: Array, symmetries: Array, tolerance_rad: float
) -> tuple[Array, Array] | None:
    """Orientations (n, 3, 3) of a die at times (n,) [s], three or more, labelled anew so that they turn evenly, the first as it
    is, and their spin (3,) [rad/s]; None if no labelling comes within the tolerance. The first two keep their labels unless these
    are surely uneven: something was known when they were given."""
    first_s = times_s[1] - times_s[0]
    given = rotation_between(quat_from_matrix(rotations[0]), quat_from_matrix(rotations[1])) / first_s
    labelled, spin, departure = _turned_evenly(rotations, times_s, symmetries, given)
    if departure < UNEVEN_RAD:
        return (labelled, spin) if departure < tolerance_rad else None
    starts = rotation_between(quat_from_matrix(rotations[0]), quat_from_matrix(rotations[1] @ symmetries))
    found = [_turned_evenly(rotations, times_s, symmetries, start / first_s) for start in starts]
    least = min(departure for *_, departure in found)
    if least > tolerance_rad:
        return None
    near = [fit for fit in found if fit[2] <= max(SAME_DEPARTURE * least, LEAST_DEPARTURE_RAD)]
    labelled, spin, _ = min(near, key=lambda fit: float(np.linalg.norm(fit[1])))
    return labelled, spin


def _turned_evenly(
    rotations: Array, times_s: Array, symmetries: Array, spin_rad_s: Array
) -> tuple[Array, Array, float]:
    """Orientations (n, 3, 3) labelled like a die that turns with about this spin, the spin (3,) from the first to the last, and
    the largest angle [rad] between one and where those before lead to."""
    labelled, spin, passed_s, missed_rad = [rotations[0]], spin_rad_s, times_s - times_s[0], 0.0
    for rotation, dt in zip(rotations[1:], passed_s[1:], strict=True):
        ahead = matrix_from_quat(quat_from_rotvec(spin * dt)) @ rotations[0]
        labelled.append(nearest_equivalent_rotation(rotation, ahead, symmetries))
        missing = rotation_between(quat_from_matrix(ahead), quat_from_matrix(labelled[-1]))
        missed_rad = max(missed_rad, float(np.linalg.norm(missing)))
        spin = spin + np.linalg.lstsq(dt * left_jacobians(spin[None] * dt)[0], missing, rcond=None)[0]
    return np.array(labelled), spin, missed_rad
