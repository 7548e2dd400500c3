"""Minimisation of the mean cost of a data set: iteratively reweighted least squares with Marquardt's damping.

The release states are held, so all throws share one set of unknowns. The normal equations are a sum over throws of k × k
blocks, and the computing time grows with the number of throws only. They are reweighted at each step (Holland & Welsch,
Comm. Stat. A 6, 813, 1977).

Derivatives are differences over steps as large as the accuracy to which parameters are ever known (`_STEPS`), since the
motion jumps where a corner touches or just does not. Frames that jump within a step show no slope and are left out of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..throw import CENTRE_OF_MASS, Physics
from .data_set import DataSet

Array = NDArray[np.float64]

_STEPS = {"chi": 0.01, "mu": 0.005, "chi_fade_s_per_m": 0.05, "mu_fade_s_per_m": 0.05, "clock_scale": 1e-3}
"""Steps of the differences of dimensionless parameters and of those that have a unit of their own."""

_LENGTH_STEP = 0.005
"""The same of lengths, in inscribed radii."""

_INERTIA_STEP = 0.02
"""The same of an inertia, relative to the die's."""

_MAX_ROUNDS = 25
"""Rounds of one descent."""

CONVERGED = 1e-3
"""Relative fall of the cost in a round below which a descent ends."""

NEARLY_CONVERGED = 1e-2
"""The same where starts are only to be compared."""

_FIRST_DAMPING = 1e-2
"""Relative damping of the first step."""

_LEAST_DAMPING = 1e-4
"""The same of any step."""

_DAMPING_FALL = 0.2
"""Factor of the damping after a step that lowers the cost."""

_DAMPING_FACTORS = (1.0, 30.0, 900.0)
"""Of the steps that one round tries until one lowers the cost."""

_JUMP = 0.3
"""Shift of a pose within one step of a difference, in circumradii, at which the motion has jumped."""

_FOLDS = 5
"""Folds of the cross-validation."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Costs and derivatives of a data set at one physics."""

    physics: Physics
    residuals: list[Array]
    """(n, 6) [m] of each throw."""
    costs: Array
    """(throws,) [m]."""
    blocks: Array
    """(throws, k, k) normal equations of each throw, in steps of the parameters."""
    right_sides: Array
    """(throws, k) of the normal equations."""
    slopes: list[Array]
    """(n, 6, k) of each throw."""
    displaced: tuple[tuple[float, Physics], ...]
    """Mean cost and physics of each point of the differences."""

    @property
    def cost(self) -> float:
        """Mean over the throws [m]."""
        return float(self.costs.mean())

    @property
    def steps(self) -> Array:
        """(k,) units of the parameters."""
        return np.array([step_of(self.physics, name) for name in self.physics.free])

    def moved(self, throws: NDArray[np.bool_] | NDArray[np.int64], damping: float = 0.0) -> Physics:
        """The physics after one step by the normal equations of some throws."""
        matrix, right = self.blocks[throws].sum(0), self.right_sides[throws].sum(0)
        return self.physics.moved(self.steps * _damped_solution(matrix, right, damping))


def minimised(data: DataSet, physics: Physics, converged: float = CONVERGED) -> Linearisation:
    """The physics of least mean cost that a descent from a start reaches.

    Each round takes the best of Gauss-Newton steps and of the displaced points of the differences, whose costs are known
    anyway: the cost of throws that diverge is rough, and the normal equations alone end in a local minimum. The
    descent ends where none of them lowers the cost by the part `converged`, whichever way the differences go.
    """
    point, damping, turned = linearised_at(data, physics), _FIRST_DAMPING, False
    for _ in range(_MAX_ROUNDS):
        cost, trial, is_step = _best_trial(data, point, damping, converged)
        if cost < (1.0 - converged) * point.cost:
            point, turned = linearised_at(data, trial), False
            damping = max(_LEAST_DAMPING, _DAMPING_FALL * damping) if is_step else damping
        elif turned or not point.displaced:
            break
        else:
            point, turned = linearised_at(data, point.physics, backwards=True), True
    return point


def _best_trial(data: DataSet, point: Linearisation, damping: float, converged: float) -> tuple[float, Physics, bool]:
    """Cost and physics of the best point at hand, and whether it is a Gauss-Newton step."""
    cost, best, is_step = np.inf, point.physics, False
    everyone = np.ones(len(data.entries), bool)
    for factor in _DAMPING_FACTORS:
        trial = point.moved(everyone, factor * damping)
        if (there := data.mean_cost(trial)) < cost:
            cost, best, is_step = there, trial, True
        if cost < (1.0 - converged) * point.cost:
            break
    for there, trial in point.displaced:
        if there < cost:
            cost, best, is_step = there, trial, False
    return cost, best, is_step


def linearised_at(data: DataSet, physics: Physics, *, backwards: bool = False) -> Linearisation:
    """Costs and derivatives at one physics, by differences towards larger values or, `backwards`, towards smaller ones."""
    here = data.residuals(physics)
    slopes: list[list[Array]] = [[] for _ in here]
    displaced: list[tuple[float, Physics]] = []
    for name in physics.free:
        step = -step_of(physics, name) if backwards else step_of(physics, name)
        low, high = physics.bounds(name)
        step = step if low <= physics.values[name] + step <= high else -step
        moved = physics.with_values(**{name: physics.values[name] + step})
        there = data.residuals(moved)
        displaced.append((float(data.costs(there).mean()), moved))
        for k, columns in enumerate(slopes):
            columns.append(-np.sign(step) * (there[k] - here[k]))
    count, jump = len(physics.free), _JUMP * physics.die.solid.circumradius
    jacobians = [
        _without_jumps(np.stack(columns, axis=2), jump) if count else np.empty((*own.shape, 0))
        for columns, own in zip(slopes, here, strict=True)
    ]
    equations = [_normal_equations(r, j, s) for r, j, s in zip(here, jacobians, data.slack, strict=True)]
    blocks, right_sides = np.array([e[0] for e in equations]), np.array([e[1] for e in equations])
    return Linearisation(physics, here, data.costs(here), blocks, right_sides, jacobians, tuple(displaced))


def left_out_residuals(data: DataSet, point: Linearisation) -> list[Array]:
    """(n, 6) of each throw, with parameters from one step by the throws of the other folds."""
    count = len(data.entries)
    fold = np.arange(count) % min(_FOLDS, count)
    moved = [point.moved(fold != k) for k in range(int(fold.max()) + 1)]
    return data.residuals_of_each([moved[k] for k in fold])


def step_of(physics: Physics, name: str) -> float:
    """The step of a parameter in a difference."""
    if name == "corner_radius_m" or name in CENTRE_OF_MASS:
        return _LENGTH_STEP * physics.die.solid.inradius
    return _INERTIA_STEP * physics.die.inertia_kg_m2 if name == "inertia_kg_m2" else _STEPS[name]


def _without_jumps(slopes: Array, jump_m: float) -> Array:
    """Slopes (n, 6, k) with zeros from the first jump on: what follows is another motion."""
    jumped = (np.linalg.norm(slopes, axis=1) > jump_m).any(1)
    first = int(np.argmax(jumped)) if jumped.any() else len(slopes)
    kept = slopes.copy()
    kept[first:] = 0.0
    return kept


def _normal_equations(residuals: Array, slopes: Array, slack: Array) -> tuple[Array, Array]:
    """Normal equations (k, k) and (k,) of one throw, its frames weighted so that squares stand for distances."""
    weight = 1.0 / np.sqrt((residuals**2).sum(1) + slack**2) / len(residuals)
    weighted = slopes * weight[:, None, None]
    return np.einsum("nij,nik->jk", weighted, slopes), np.einsum("nij,ni->j", weighted, residuals)


def _damped_solution(matrix: Array, right: Array, damping: float) -> Array:
    """The damped step; directions without information stay."""
    damped = matrix + damping * np.diag(np.diag(matrix))
    scale = np.sqrt(np.maximum(np.diag(damped), 1e-300))
    return np.asarray(np.linalg.lstsq(damped / np.outer(scale, scale), right / scale, rcond=1e-12)[0] / scale)
