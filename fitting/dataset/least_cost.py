"""The physics of least cost for a crowd of throws: iterated reweighting with Marquardt's damping.

With the starts held there is one set of unknowns for all throws, and the normal equations are a sum over throws of k × k
blocks: the cost grows with the number of throws, no more. They are solved by iterated reweighting (Holland & Welsch,
Comm. Stat. A 6, 813, 1977). Derivatives are differences over steps as large as the parameters are ever known (`_STEPS`),
since the course of a throw jumps where a corner touches or just does not; frames that jump within a step tell nothing of
a slope, and are left out of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..throw import LOAD, Physics
from .data_set import Crowd

Array = NDArray[np.float64]

_STEPS = {"chi": 0.01, "mu": 0.005, "chi_fade_s_per_m": 0.05, "mu_fade_s_per_m": 0.05, "clock_scale": 1e-3}
"""Steps of the differences; of lengths `_LENGTH_STEP` of the inscribed radius, of an inertia `_INERTIA_STEP` of the die's."""

_LENGTH_STEP, _INERTIA_STEP = 0.005, 0.02

_MOST_ROUNDS = 12
CONVERGED, CONVERGED_ENOUGH = 1e-3, 1e-2
"""Part of the cost by which a step must lower it to be followed by another; and where only an effect is to be judged."""

_JUMP = 0.3
"""Part of the circumradius by which a pose moves within one step of a difference where the throw has jumped course."""

_FOLDS = 5


@dataclass(frozen=True, eq=False)
class Point:
    """Physics at which a crowd has been seen."""

    physics: Physics
    misses: list[Array]
    costs: Array
    """(throws,) [m]."""
    blocks: Array
    """(throws, k, k) normal equations of each throw, in steps of the parameters."""
    pulls: Array
    """(throws, k) their right sides."""
    slopes: list[Array]
    """(n, 6, k) of each throw."""

    @property
    def steps(self) -> Array:
        """(k,) units of the parameters."""
        return np.array([step_of(self.physics, name) for name in self.physics.free])

    def moved(self, throws: NDArray[np.bool_] | NDArray[np.int64], damping: float = 0.0) -> Physics:
        """The physics after one step by the normal equations of some throws."""
        matrix, right = self.blocks[throws].sum(0), self.pulls[throws].sum(0)
        return self.physics.moved(self.steps * _solved(matrix, right, damping))


def descended(crowd: Crowd, physics: Physics, converged: float = CONVERGED) -> Point:
    """The physics of least cost, from a start."""
    point, damping = seen_from(crowd, physics), 1e-2
    everyone = np.ones(len(crowd.entries), bool)
    for _ in range(_MOST_ROUNDS):
        trial = point.moved(everyone, damping)
        gain = 1.0 - crowd.mean_cost(trial) / max(float(point.costs.mean()), 1e-300)
        if gain > 0.0:
            point, damping = seen_from(crowd, trial), 0.2 * damping
            if gain < converged:
                break
        elif damping > 1.0:
            break
        else:
            damping *= 30.0
    return point


def seen_from(crowd: Crowd, physics: Physics) -> Point:
    """Cost and derivatives at some physics."""
    here = crowd.misses(physics)
    slopes: list[list[Array]] = [[] for _ in here]
    for name in physics.free:
        step = step_of(physics, name)
        _, high = physics.bounds(name)
        sign = 1.0 if physics.values[name] + step <= high else -1.0
        there = crowd.misses(physics.with_values(**{name: physics.values[name] + sign * step}))
        for k, columns in enumerate(slopes):
            columns.append(-sign * (there[k] - here[k]))
    jump = _JUMP * physics.die.solid.circumradius
    jacobians = [_without_jumps(np.stack(columns, axis=2), jump) for columns in slopes]
    weighted = [_equations(r, j, s) for r, j, s in zip(here, jacobians, crowd.slack, strict=True)]
    blocks, pulls = np.array([w[0] for w in weighted]), np.array([w[1] for w in weighted])
    return Point(physics, here, crowd.costs(here), blocks, pulls, jacobians)


def left_out_misses(crowd: Crowd, point: Point) -> list[Array]:
    """(n, 6) of each throw with the parameters that the throws of the other folds ask for."""
    count = len(crowd.entries)
    fold = np.arange(count) % min(_FOLDS, count)
    moved = [point.moved(fold != k) for k in range(int(fold.max()) + 1)]
    return crowd.misses_of_each([moved[k] for k in fold])


def step_of(physics: Physics, name: str) -> float:
    """The step of a parameter in a difference."""
    if name == "corner_radius_m" or name in LOAD:
        return _LENGTH_STEP * physics.die.solid.inradius
    return _INERTIA_STEP * physics.die.inertia_kg_m2 if name == "inertia_kg_m2" else _STEPS[name]


def _without_jumps(slopes: Array, jump_m: float) -> Array:
    """Slopes (n, 6, k) with the frames from the first jump on set to zero: what follows is another course."""
    jumped = (np.linalg.norm(slopes, axis=1) > jump_m).any(1)
    first = int(np.argmax(jumped)) if jumped.any() else len(slopes)
    kept = slopes.copy()
    kept[first:] = 0.0
    return kept


def _equations(misses: Array, slopes: Array, slack: Array) -> tuple[Array, Array]:
    """Normal equations (k, k) and (k,) of one throw, its frames weighted so that squares stand for distances."""
    weight = 1.0 / np.sqrt((misses**2).sum(1) + slack**2) / len(misses)
    weighted = slopes * weight[:, None, None]
    return np.einsum("nij,nik->jk", weighted, slopes), np.einsum("nij,ni->j", weighted, misses)


def _solved(matrix: Array, right: Array, damping: float) -> Array:
    damped = matrix + damping * np.diag(np.diag(matrix))
    scale = np.sqrt(np.maximum(np.diag(damped), 1e-300))
    return np.asarray(np.linalg.lstsq(damped / np.outer(scale, scale), right / scale, rcond=1e-12)[0] / scale)
