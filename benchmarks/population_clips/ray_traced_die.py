"""The light of a moving die on a supersampled picture, by rays: compiled kernels on plain arrays.

A die with corner radius r is the set of points within r of its inner polyhedron, whose faces lie r further in than those of
the sharp one. Its surface consists of flat faces, cylinders of radius r about the inner edges and spheres of radius r about
the inner corners. A ray enters the sharp polyhedron through one face. If the foot of the entry point on the inner
polyhedron lies within the inner face, the ray hits the flat part there; otherwise it hits the first of all cylinders and
spheres, or nothing. No contour, edge or mesh is involved, so that the pictures share nothing with a method that tracks them.

Shading: a diffuse coat under a clear one. The diffuse coat sees an ambient light that is brighter from above and a lamp of
stated angular size. The clear coat reflects the lamp with Schlick's approximation of Fresnel's law (refractive index 1.5)
as a spherical Gaussian lobe, whose width is that of the lamp and the roughness together.

Frames of reference: rays come in world coordinates and are taken to the body frame of the die at their own instant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRESNEL_AT_NORMAL = 0.04
"""Reflectance of a dielectric of refractive index 1.5 at normal incidence."""


class Body(NamedTuple):
    """The die in its body frame."""

    normals: Array
    """(faces, 3) outward, unit."""
    offsets: Array
    """(faces,) [m] of the sharp faces from the origin."""
    corners: Array
    """(corners, 3) [m] of the inner polyhedron."""
    edges: NDArray[np.int64]
    """(edges, 2) indices of corners."""
    radius: float
    """[m] of the rounding."""
    right: Array
    """(faces, 3) unit vector along the columns of the tile of each face."""
    up: Array
    """(faces, 3) unit vector against its rows."""
    middles: Array
    """(faces, 3) [m] centre of each face."""
    half_m: float
    """Half the width of a tile."""
    tiles: NDArray[np.float32]
    """(faces, n, n) albedo."""
    bevel_albedo: float


class Light(NamedTuple):
    """The lamp and the surroundings."""

    towards: Array
    """(3,) unit vector to the lamp, world axes."""
    lamp: float
    """Irradiance of the lamp at normal incidence."""
    sky: float
    """Ambient irradiance from above."""
    ground: float
    """Ambient irradiance from below."""
    gloss: float
    """Share of the clear coat: 0 for a matt die, 1 for a polished one."""
    lobe: float
    """Sharpness of the lamp's reflection [1/rad²]."""
    peak: float
    """Radiance of the lamp in its reflection."""


@njit(cache=True)
def squared_reach(body: Body) -> float:
    """[m²] of the smallest sphere about the centre that holds the rounded die."""
    longest = 0.0
    for c in body.corners:
        longest = max(longest, np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]))
    return (longest + body.radius) ** 2


@njit(cache=True)
def first_hit(body: Body, o: Array, d: Array, normal: Array) -> tuple[float, int]:
    """Distance along the ray to the surface and the face that is hit (-1 for the rounding, -2 for none); sets the normal."""
    t_in, t_out, face = -1e30, 1e30, -1
    for f in range(len(body.offsets)):
        n = body.normals[f]
        slope = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
        gap = body.offsets[f] - (n[0] * o[0] + n[1] * o[1] + n[2] * o[2])
        if slope < -1e-14:
            t = gap / slope
            if t > t_in:
                t_in, face = t, f
        elif slope > 1e-14:
            t_out = min(t_out, gap / slope)
        elif gap < 0.0:
            return 0.0, -2
        if t_in > t_out:
            return 0.0, -2
    if face < 0:
        return 0.0, -2
    r = body.radius
    if r == 0.0:
        normal[:] = body.normals[face]
        return t_in, face
    m = body.normals[face]
    x, y, z = (o[0] + t_in * d[0] - r * m[0], o[1] + t_in * d[1] - r * m[1], o[2] + t_in * d[2] - r * m[2])
    flat = True
    for g in range(len(body.offsets)):
        n = body.normals[g]
        if g != face and n[0] * x + n[1] * y + n[2] * z > body.offsets[g] - r:
            flat = False
            break
    if flat:
        normal[:] = m
        return t_in, face
    best = 1e30
    for e in range(len(body.edges)):
        a, b = body.corners[body.edges[e, 0]], body.corners[body.edges[e, 1]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        length2 = ux * ux + uy * uy + uz * uz
        wx, wy, wz = o[0] - a[0], o[1] - a[1], o[2] - a[2]
        du = (d[0] * ux + d[1] * uy + d[2] * uz) / length2
        wu = (wx * ux + wy * uy + wz * uz) / length2
        px, py, pz = d[0] - du * ux, d[1] - du * uy, d[2] - du * uz
        qx, qy, qz = wx - wu * ux, wy - wu * uy, wz - wu * uz
        aa, bb, cc = (
            px * px + py * py + pz * pz,
            px * qx + py * qy + pz * qz,
            qx * qx + qy * qy + qz * qz - r * r,
        )
        under = bb * bb - aa * cc
        if aa < 1e-20 or under < 0.0:
            continue
        t = (-bb - np.sqrt(under)) / aa
        along = wu + t * du
        if t < best and 0.0 <= along <= 1.0:
            best = t
            for k in range(3):
                normal[k] = (o[k] + t * d[k] - (a[k] + along * (b[k] - a[k]))) / r
    for v in range(len(body.corners)):
        c = body.corners[v]
        wx, wy, wz = o[0] - c[0], o[1] - c[1], o[2] - c[2]
        bb = wx * d[0] + wy * d[1] + wz * d[2]
        under = bb * bb - (wx * wx + wy * wy + wz * wz - r * r)
        if under < 0.0:
            continue
        t = -bb - np.sqrt(under)
        if t < best:
            # A point on the sphere belongs to the surface where no inner face, edge or other corner is nearer: the
            # sphere lies inside the body everywhere else, behind what was hit before.
            best = t
            for k in range(3):
                normal[k] = (o[k] + t * d[k] - c[k]) / r
    if best > 1e29:
        return 0.0, -2
    return best, -1


@njit(cache=True)
def albedo_at(body: Body, face: int, x: float, y: float, z: float) -> float:
    """The paint at a point of a flat face, bilinear in its tile."""
    c, right, up = body.middles[face], body.right[face], body.up[face]
    size = body.tiles.shape[1]
    px, py, pz = x - c[0], y - c[1], z - c[2]
    u = ((px * right[0] + py * right[1] + pz * right[2]) / body.half_m + 1.0) * 0.5 * size - 0.5
    v = (1.0 - (px * up[0] + py * up[1] + pz * up[2]) / body.half_m) * 0.5 * size - 0.5
    u, v = min(max(u, 0.0), size - 1.001), min(max(v, 0.0), size - 1.001)
    i, j = int(v), int(u)
    fv, fu = v - i, u - j
    tile = body.tiles[face]
    return (tile[i, j] * (1 - fu) + tile[i, j + 1] * fu) * (1 - fv) + (
        tile[i + 1, j] * (1 - fu) + tile[i + 1, j + 1] * fu
    ) * fv


@njit(cache=True)
def shade(light: Light, albedo: float, n: Array, d: Array) -> float:
    """Radiance from a point of the surface towards the camera; normal and direction of the ray in world axes."""
    lit = n[0] * light.towards[0] + n[1] * light.towards[1] + n[2] * light.towards[2]
    share = 0.5 * (1.0 + n[2])
    radiance = albedo * (light.lamp * max(lit, 0.0) + light.sky * share + light.ground * (1.0 - share))
    if light.gloss > 0.0:
        facing = -(n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
        fresnel = FRESNEL_AT_NORMAL + (1.0 - FRESNEL_AT_NORMAL) * max(1.0 - facing, 0.0) ** 5
        rx, ry, rz = d[0] + 2.0 * facing * n[0], d[1] + 2.0 * facing * n[1], d[2] + 2.0 * facing * n[2]
        along = rx * light.towards[0] + ry * light.towards[1] + rz * light.towards[2]
        around = light.sky * max(rz, 0.0) + light.ground * max(-rz, 0.0)
        radiance += light.gloss * fresnel * (light.peak * np.exp(-light.lobe * (1.0 - along)) + around)
    return radiance


@njit(cache=True, nogil=True)
def render(
    body: Body, light: Light, eye: Array, rays: Array, rotations: Array, positions: Array, window: Array, samples: int
) -> tuple[Array, Array]:
    """Light (rows, columns) that the die sends, and the share that it covers, on a part of the supersampled picture.

    `rays` (rows, columns, 3) are unit vectors in world axes from `eye` (3,). `rotations` (poses, 3, 3) and `positions`
    (poses, 3) sample the motion evenly; `window` (rows, 2) has the first pose and the one after the last while each row is
    exposed. Each subpixel averages `samples` instants, whose offsets differ between neighbours in an even pattern.
    """
    rows, columns = rays.shape[:2]
    radiance, cover = np.zeros((rows, columns)), np.zeros((rows, columns))
    reach2 = squared_reach(body)
    o, d, normal, turned = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(rows):
        first, span = window[i, 0], window[i, 1] - window[i, 0]
        for j in range(columns):
            # The golden ratio and its square spread the offsets of neighbouring subpixels evenly.
            offset = (0.7548776662466927 * i + 0.5698402909980532 * j) % 1.0
            for s in range(samples):
                pose = int(first + span * (s + offset) / samples)
                R, c = rotations[pose], positions[pose]
                # Most rays miss the circumscribed sphere.
                wx, wy, wz = eye[0] - c[0], eye[1] - c[1], eye[2] - c[2]
                along = wx * rays[i, j, 0] + wy * rays[i, j, 1] + wz * rays[i, j, 2]
                if wx * wx + wy * wy + wz * wz - along * along > reach2:
                    continue
                for k in range(3):
                    o[k] = R[0, k] * (eye[0] - c[0]) + R[1, k] * (eye[1] - c[1]) + R[2, k] * (eye[2] - c[2])
                    d[k] = R[0, k] * rays[i, j, 0] + R[1, k] * rays[i, j, 1] + R[2, k] * rays[i, j, 2]
                t, face = first_hit(body, o, d, normal)
                if face == -2:
                    continue
                albedo = body.bevel_albedo
                if face >= 0:
                    albedo = albedo_at(body, face, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
                for k in range(3):
                    turned[k] = R[k, 0] * normal[0] + R[k, 1] * normal[1] + R[k, 2] * normal[2]
                radiance[i, j] += shade(light, albedo, turned, rays[i, j]) / samples
                cover[i, j] += 1.0 / samples
    return radiance, cover


@njit(cache=True, nogil=True)
def shadow(body: Body, points: Array, rotation: Array, position: Array, lamps: Array) -> Array:
    """(rows, columns) share of the lamp's light that the die keeps from points (rows, columns, 3) of the table.

    `lamps` (n, 3) are unit vectors to places on the lamp; each point uses four of them, in a pattern.
    """
    rows, columns = points.shape[:2]
    dark = np.zeros((rows, columns))
    reach2 = squared_reach(body)
    o, d, normal = np.empty(3), np.empty(3), np.empty(3)
    for i in range(rows):
        for j in range(columns):
            p = points[i, j]
            for k in range(3):
                o[k] = (
                    rotation[0, k] * (p[0] - position[0])
                    + rotation[1, k] * (p[1] - position[1])
                    + rotation[2, k] * (p[2] - position[2])
                )
            for s in range(4):
                towards = lamps[(7 * i + 3 * j + s * len(lamps) // 4) % len(lamps)]
                wx, wy, wz = p[0] - position[0], p[1] - position[1], p[2] - position[2]
                along = wx * towards[0] + wy * towards[1] + wz * towards[2]
                if not wx * wx + wy * wy + wz * wz - along * along < reach2:
                    continue
                for k in range(3):
                    d[k] = rotation[0, k] * towards[0] + rotation[1, k] * towards[1] + rotation[2, k] * towards[2]
                t, face = first_hit(body, o, d, normal)
                if face != -2 and t > 0.0:
                    dark[i, j] += 0.25
    return dark
