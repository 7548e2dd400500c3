"""Rotations as unit quaternions `wxyz` that take body axes to world axes.

A fit asks tens of thousands of times for the rotation vectors of one or a few hundred poses, where the calls of
`scipy.spatial.transform.Rotation` cost more than the arithmetic: these are written in NumPy. Matrices and Euler angles are
scipy's. The paper's Euler angles (ψ, ϑ, φ; Kapitaniak et al., Chaos 22, 047504, Eq. 5) are the intrinsic z-x-z sequence:
R = Rz(ψ) Rx(ϑ) Rz(φ).
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

LEAST_SINE = 1e-150
"""Sine of half an angle below which its ratio to that is its limit: the squares of smaller ones vanish."""


def matrix_from_quat(quaternion: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz."""
    q = np.asarray(quaternion, float)
    flat = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix()
    return np.asarray(flat.reshape(*q.shape[:-1], 3, 3))


def quat_from_matrix(matrix: ArrayLike) -> Array:
    """Unit quaternions (..., 4) wxyz, with w >= 0, of rotation matrices (..., 3, 3)."""
    m = np.asarray(matrix, float)
    flat = Rotation.from_matrix(m.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return np.asarray(flat.reshape(*m.shape[:-2], 4))


def quat_from_rotvec(rotvec: ArrayLike) -> Array:
    """Unit quaternions (..., 4) wxyz of rotation vectors (..., 3) [rad]."""
    v = np.asarray(rotvec, float)
    half = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * v], axis=-1)


def rotvec_from_quat(quaternion: ArrayLike) -> Array:
    """Rotation vectors (..., 3) [rad], no longer than pi, of quaternions (..., 4) wxyz; NaN of what is NaN.

    Of the two quaternions of a rotation, that of the shorter turn counts. The arctangent keeps all digits near 0 and pi.
    """
    q = np.asarray(quaternion, float)
    w, v = q[..., :1], q[..., 1:]
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    small = sine < LEAST_SINE
    ratio = np.where(small, 1.0, np.arctan2(sine, np.abs(w)) / np.where(small, 1.0, sine))
    return np.asarray(np.copysign(2.0, w) * ratio * v)


def quat_multiply(left: ArrayLike, right: ArrayLike) -> Array:
    """Hamilton products (..., 4): the rotation `right`, then `left`. The sign is kept, unlike in scipy's composition."""
    a, b = np.asarray(left, float), np.asarray(right, float)
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    w = aw * bw - ax * bx - ay * by - az * bz
    product = np.empty((*np.shape(w), 4))
    product[..., 0] = w
    product[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    product[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    product[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return product


def quat_conjugate(quaternion: ArrayLike) -> Array:
    """The inverse rotations (..., 4) of unit quaternions (..., 4)."""
    return np.asarray(quaternion, float) * np.array([1.0, -1.0, -1.0, -1.0])


def rotation_between(start: ArrayLike, end: ArrayLike) -> Array:
    """Rotation vectors v (..., 3) [rad, world axes] from the quaternions `start` to `end`: end = exp(v) start."""
    return rotvec_from_quat(quat_multiply(end, quat_conjugate(start)))


def angle_between(start: ArrayLike, end: ArrayLike) -> Array:
    """Angles (...) [rad], 0 to pi, between rotations: quaternions (..., 4), or matrices (..., 3, 3), of which some may be NaN.

    The angle of matrices follows from its sine and cosine. The cosine alone has half the digits near 0 and pi.
    """
    a, b = np.asarray(start, float), np.asarray(end, float)
    if a.shape[-1] == 4:
        return np.asarray(np.linalg.norm(rotation_between(a, b), axis=-1))
    R = b @ np.swapaxes(a, -1, -2)
    axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return np.asarray(np.arctan2(np.linalg.norm(axis, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1.0))


def cross_matrix(vectors: Array) -> Array:
    """Matrices [v]× (..., 3, 3) of vectors v (..., 3): [v]× w = v × w."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrices = np.zeros((*np.shape(x), 3, 3))
    matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2] = -z, y, -x
    matrices[..., 1, 0], matrices[..., 2, 0], matrices[..., 2, 1] = z, -y, x
    return matrices


def continuous_sign(quaternions: ArrayLike) -> Array:
    """The same rotations (n, 4), with signs such that neighbours have a positive scalar product; NaN rows stay."""
    q = np.array(quaternions, float)
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    sign_changes = (q[known[1:]] * q[known[:-1]]).sum(1) < 0
    flipped = known[1:][np.cumsum(sign_changes) % 2 == 1]
    q[flipped] = -q[flipped]
    return q


def quat_from_euler(euler_rad: ArrayLike) -> Array:
    """Quaternions (..., 4) of the paper's Euler angles (..., 3): ψ, ϑ, φ [rad], R = Rz(ψ) Rx(ϑ) Rz(φ)."""
    e = np.asarray(euler_rad, float)
    flat = Rotation.from_euler("ZXZ", e.reshape(-1, 3)).as_quat(scalar_first=True)
    return np.asarray(flat.reshape(*e.shape[:-1], 4))


def euler_from_quat(quaternion: ArrayLike) -> Array:
    """The paper's Euler angles (..., 3) ψ, ϑ, φ [rad]. At ϑ = 0 and π only ψ ± φ is determined, and φ is set to 0."""
    q = np.asarray(quaternion, float)
    with warnings.catch_warnings():
        # scipy warns at ϑ = 0 and π and sets the third angle to zero, which is the convention stated above.
        warnings.filterwarnings("ignore", message="Gimbal lock")
        flat = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_euler("ZXZ")
    return np.asarray(flat.reshape(*q.shape[:-1], 3))
