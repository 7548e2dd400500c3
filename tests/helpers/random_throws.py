"""Dice and releases for the tests: seeded, so that every run asks the same questions."""

from __future__ import annotations

import numpy as np

from diethrow.model.die.die import Die, make_die
from diethrow.model.die.solid import SHAPES
from diethrow.model.throw.motion import State

DICE = {shape: make_die(shape, 0.02, 0.016) for shape in SHAPES}
"""The five isohedral dice, of the size and mass of the paper's cube."""


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """Uniform over the rotations."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def lowest_vertex_m(die: Die, state: State) -> float:
    """Height [m] of the lowest vertex of the sharp polyhedron above a level table."""
    return float((die.solid.vertices @ state.rotation[2]).min() + state.position_m[2])


def random_release(rng: np.random.Generator, die: Die, *, spin_rad_s: float = 40.0, clearance_m: float = 0.1) -> State:
    """Any orientation, a spin of the given size about any axis, a toss of about 0.5 m/s, the lowest vertex clear."""
    quaternion, axis = random_quaternion(rng), rng.normal(size=3)
    resting = State(0.0, np.zeros(3), quaternion, np.zeros(3), np.zeros(3))
    position = np.array([*rng.normal(scale=0.05, size=2), clearance_m - lowest_vertex_m(die, resting)])
    omega = spin_rad_s * axis / np.linalg.norm(axis)
    return State(float(rng.uniform(-1.0, 1.0)), position, quaternion, rng.normal(scale=0.5, size=3), omega)
