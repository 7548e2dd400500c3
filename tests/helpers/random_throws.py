"""Dice and random releases for the tests, with fixed seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diethrow.model.die.die import Die, make_die
from diethrow.model.die.solid import SHAPES
from diethrow.model.rotations import quat_from_matrix, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import State

DICE = {shape: make_die(shape, 0.02, 0.016) for shape in SHAPES}
"""The five isohedral dice, of the size and mass of the paper's cube."""


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """A unit quaternion, uniformly distributed over the rotations."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def turned_down(down: np.ndarray, tilt_rad: float = 0.0) -> np.ndarray:
    """Quaternion that turns a direction of the body (3,) down, and then tilts it about the world's x axis."""
    down = down / np.linalg.norm(down)
    x = np.cross(down, [0.3, -0.5, 0.8])
    x /= np.linalg.norm(x)
    upright = quat_from_matrix([x, np.cross(-down, x), -down])
    return quat_multiply(quat_from_rotvec([tilt_rad, 0.0, 0.0]), upright)


def exact_octahedron(edge_m: float = 0.02, mass_kg: float = 0.016) -> Die:
    """An octahedron with its vertices on the axes to the last bit, so that a drop on a tip is that of a ball."""
    die = make_die("octahedron", edge_m, mass_kg)
    radius = die.solid.circumradius
    return replace(die, solid=replace(die.solid, vertices=np.round(die.solid.vertices / radius) * radius))


def disturbed(start: State, step: np.ndarray) -> State:
    """The state moved by the first twelve of (12 or more,); rotations act in world axes."""
    return State(
        start.time_s,
        start.position_m + step[:3],
        quat_multiply(quat_from_rotvec(step[3:6]), start.quaternion),
        start.velocity_m_s + step[6:9],
        start.omega_rad_s + step[9:12],
    )


def state_difference(one: State, other: State) -> np.ndarray:
    """(12,) from one state to the other: position, rotation vector, velocity, angular velocity."""
    return np.concatenate(
        [
            other.position_m - one.position_m,
            rotation_between(one.quaternion, other.quaternion),
            other.velocity_m_s - one.velocity_m_s,
            other.omega_rad_s - one.omega_rad_s,
        ]
    )


def lowest_vertex_m(die: Die, state: State) -> float:
    """Height [m] of the lowest vertex of the sharp polyhedron above a level table."""
    return float((die.solid.vertices @ state.rotation[2]).min() + state.position_m[2])


def random_release(rng: np.random.Generator, die: Die, *, spin_rad_s: float = 40.0, clearance_m: float = 0.1) -> State:
    """A random orientation and spin axis, a velocity of about 0.5 m/s, and the lowest vertex `clearance_m` above the table."""
    quaternion, axis = random_quaternion(rng), rng.normal(size=3)
    resting = State(0.0, np.zeros(3), quaternion, np.zeros(3), np.zeros(3))
    position = np.array([*rng.normal(scale=0.05, size=2), clearance_m - lowest_vertex_m(die, resting)])
    omega = spin_rad_s * axis / np.linalg.norm(axis)
    return State(float(rng.uniform(-1.0, 1.0)), position, quaternion, rng.normal(scale=0.5, size=3), omega)
