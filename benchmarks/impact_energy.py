"""Energy of random impacts with friction: `python benchmarks/impact_energy.py [impacts] [seed]`.

Random dice of the five shapes and two extreme bodies (a rod and a disc, with a hundred times the inertia about one axis as
about another), and a random corner at a random orientation. χ is uniform in [0, 1], and exactly 0 or 1 in a tenth of the
impacts each. μ is uniform in [0, 5], and below 0.01 in a tenth. The slip is 1e-3 to 1e3 times the normal velocity. The
change of energy is relative to the kinetic energy before the impact that the contact can reach, cᵀM⁻¹c/2, which is the
strictest reference because the whole kinetic energy is larger. Prints, for each kind of restitution: how often energy was
created (by more than 1e-12), the largest change (negative: every impact lost energy), and the time of an impact.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from numba import njit
from numpy.typing import NDArray

from diethrow.model import engine
from diethrow.model.die.die import make_die
from diethrow.model.die.solid import SHAPES
from diethrow.model.rotations import matrix_from_quat

Array = NDArray[np.float64]
RESTITUTIONS = {
    "newton": engine.NEWTON,
    "poisson": engine.POISSON,
    "stronge": engine.STRONGE,
    "algebraic": engine.ALGEBRAIC,
}
BODIES = (*SHAPES, "rod", "disc")

CREATED = 1e-12
"""Relative gain of energy above which an impact created energy rather than rounding."""


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """(count, 3, 3), uniform."""
    q = rng.normal(size=(count, 4))
    return matrix_from_quat(q / np.linalg.norm(q, axis=1)[:, None])


def random_matrices(rng: np.random.Generator, body: str, count: int) -> Array:
    """Contact matrices (count, 3, 3) [1/kg] of corners of a die of 1 kg and 1 m, or of a rod or disc."""
    die = make_die(body if body in SHAPES else "cube", 1.0, 1.0)
    thin = {"rod": [1.0, 1.0, 0.01], "disc": [0.01, 0.01, 1.0]}.get(body, [1.0, 1.0, 1.0])
    turn = random_rotations(rng, count)
    arms = np.einsum("nij,nj->ni", turn, die.solid.vertices[rng.integers(len(die.solid.vertices), size=count)])
    inverse = np.einsum("nij,j,nkj->nik", turn, 1.0 / (die.inertia_kg_m2 * np.array(thin)), turn)
    cross = np.zeros((count, 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -arms[:, 2], arms[:, 1], -arms[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    return np.asarray(np.eye(3) / die.mass_kg - cross @ inverse @ cross)


@njit  # not cached, because a cache of this file would not see an edit of the kernel
def impulses(six: Array, chi: Array, mu: Array, ending: int, velocity: Array, out: Array) -> None:
    """Impulses (n, 3) of n impacts into `out`."""
    for i in range(six.shape[0]):
        matrix = (six[i, 0], six[i, 1], six[i, 2], six[i, 3], six[i, 4], six[i, 5])
        c = velocity[i]
        out[i, 0], out[i, 1], out[i, 2] = engine.friction_impulse(matrix, chi[i], mu[i], ending, c[0], c[1], c[2])


def main(count: int, seed: int) -> None:
    """Print the table."""
    rng = np.random.default_rng(seed)
    each = count // len(BODIES)
    matrices = np.concatenate([random_matrices(rng, body, each) for body in BODIES])
    n = len(matrices)
    velocity = rng.normal(size=(n, 3))
    velocity[:, 2] = -np.abs(velocity[:, 2])
    velocity[:, :2] *= 10.0 ** rng.uniform(-3, 3, (n, 1))
    chi, mu, special = rng.uniform(size=n), rng.uniform(0.0, 5.0, n), rng.uniform(size=n)
    chi[special < 0.2] = (special < 0.1)[special < 0.2]
    mu[special > 0.9] *= 2e-3
    six = np.ascontiguousarray(matrices[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]])
    reach = 0.5 * np.einsum("ni,ni->n", velocity, np.linalg.solve(matrices, velocity[..., None])[..., 0])
    dice = np.arange(n) < len(SHAPES) * each
    print(f"{n} impacts, seed {seed}")
    print(f"{'restitution':12} {'created energy':>15} {'of dice alone':>14} {'largest':>10} {'of dice':>10} {'µs':>6}")
    for name, ending in RESTITUTIONS.items():
        out = np.empty((n, 3))
        impulses(six[:1], chi[:1], mu[:1], ending, velocity[:1], out[:1])
        began = time.perf_counter()
        impulses(six, chi, mu, ending, velocity, out)
        spent = time.perf_counter() - began
        after = velocity + np.einsum("nij,nj->ni", matrices, out)
        change = 0.5 * np.sum(out * (velocity + after), axis=1) / reach
        created = change > CREATED
        print(
            f"{name:12} {created.mean():15.4%} {created[dice].mean():14.4%} {change.max():10.2e} "
            f"{change[dice].max():10.2e} {spent / n * 1e6:6.2f}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
