"""The search for the parameters of a data set: descents from many starts, and the spread of what random halves find.

**Minima.** The cost has several, since parameters trade against each other (χ against μ against a radius). Descents start
from points drawn over the whole range of usual values, on some of the throws. Where they end, points closer than a
few steps of the differences count as one minimum. The best are refined on all throws, and all are reported with their cost.

**Spread.** The throws are divided at random into two halves, each of which searches for itself, from starts of its own. Half the
difference of what the halves find has the variance of what all throws find (balanced half samples, McCarthy, Rev. Int. Stat.
Inst. 37, 239, 1969). So the scatter between throws, the errors of the law, and which minimum is found by chance all enter the
covariance. What other effects would make of the parameters, which other samples of the throws choose, is added. It has no more
degrees of freedom than divisions, or throws less one.

**Estimate.** The mean of what all halves find (bagging, Breiman, Machine Learning 24, 123, 1996): in it the local minima of a
rough cost, in which one search ends by chance, average out. Of few throws it is the best minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from ..throw import Physics
from .data_set import DataSet
from .joint_effects import ChosenEffects
from .minimisation import NEARLY_CONVERGED, Linearisation, minimised, step_of

Array = NDArray[np.float64]
Advance = Callable[[], None]

STARTS = 6
"""Descents of a search, the one from the parameters at hand included."""

SPLITS = 10
"""Random divisions into halves: they determine a standard error to a quarter of itself."""

_FEWEST_FOR_MEAN = 16
"""Throws from which the mean over halves is the estimate: halves of fewer determine little by themselves."""

_HALF_STARTS = 2
"""Starts of the search of each half that no other search has led to."""

_HALF_THROWS = 40
"""Most throws of a half: the variance of many throws follows from that of fewer, in proportion."""

_CHOICE_DRAWS = 400
"""Samples of throws for which the choice of effects is repeated."""

_SEARCH_THROWS = 40
"""Throws, spread over all, on which descents from many starts are compared."""

_REFINED = 2
"""Minima that are refined on all throws."""

_SAME_STEPS = 3.0
"""Steps of the differences within which all parameters of two points belong to one minimum."""

_RANGES: dict[str, tuple[float, float]] = {
    "chi": (0.5, 1.6),
    "mu": (0.4, 2.5),
    "inertia_kg_m2": (0.8, 1.25),
}
"""Factors of the parameters at hand between which starts lie."""

_RADII = (0.0, 0.25)
"""The same of corner radii, in inscribed radii."""

_FADES_S_PER_M = (0.01, 1.0)
"""The same of fading restitution and friction."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """One minimum of the cost."""

    physics: Physics
    cost_m: float
    """Mean over all throws."""


@dataclass(frozen=True, eq=False)
class Spread:
    """How far the free parameters of halves of the throws lie apart."""

    names: tuple[str, ...]
    mean: Array
    """(k,) of what all halves find."""
    draws: Array
    """(divisions, k) half the difference of what two halves find, each a draw of the errors of all throws."""
    by_choice: Array
    """(k, k) covariance from the choice of effects, which other throws may have made otherwise."""
    freedom: int
    """Degrees of freedom of the covariance."""
    throws: int

    @property
    def covariance(self) -> Array:
        """(k, k) of the parameters from all throws."""
        return np.asarray(self.draws.T @ self.draws / len(self.draws) + self.by_choice)

    @property
    def is_of_many(self) -> bool:
        """Whether the mean over halves is the estimate."""
        return self.throws >= _FEWEST_FOR_MEAN

    def trade_offs(self, least: float) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose errors have a correlation of size `least` or more, and the correlation."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        correlation = self.covariance / np.outer(deviations, deviations)
        rows, columns = np.triu_indices(len(self.names), 1)
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        found = [(self.names[i], self.names[j], float(correlation[i, j])) for i, j in pairs]
        return [pair for pair in found if abs(pair[2]) >= least]

    def half_widths(self, level: float) -> Array:
        """(k,) of intervals of a level, by Student's t."""
        return np.asarray(stdtrit(self.freedom, 0.5 + 0.5 * level) * np.sqrt(np.diag(self.covariance)))


def best_of_minima(
    data: DataSet, physics: Physics, advance: Advance
) -> tuple[tuple[Linearisation, ...], tuple[Minimum, ...]]:
    """The best points that descents from many starts reach, and all minima, each with the best first."""
    some = data.subset(_SEARCH_THROWS)
    ends: list[Physics] = []
    for start in _starts(physics):
        end = minimised(some, start, NEARLY_CONVERGED).physics
        if not any(_are_one(end, other) for other in ends):
            ends.append(end)
        advance()
    ends.sort(key=data.mean_cost)
    refined = sorted((minimised(data, end) for end in ends[:_REFINED]), key=lambda point: point.cost)
    minima = [Minimum(point.physics, point.cost) for point in refined]
    for end in ends[_REFINED:]:
        if not any(_are_one(end, other.physics) for other in minima):
            minima.append(Minimum(end, data.mean_cost(end)))
    return tuple(refined), tuple(minima)


def spread_of(data: DataSet, points: tuple[Linearisation, ...], effects: ChosenEffects, advance: Advance) -> Spread:
    """The spread of what throws like these find, and of the effects that they choose. `points` are the best of the search on all
    throws."""
    count = len(data.entries)
    rng, names = np.random.default_rng(0), points[0].physics.free
    half = min(count // 2, _HALF_THROWS)
    draws, means = [], []
    for _ in range(min(SPLITS, _divisions(count))):
        order = rng.permutation(count)
        found = [_found_by(data, np.sort(which), points, rng) for which in (order[:half], order[half : 2 * half])]
        # Var(a - b) = 2 σ²/m for two sets of m throws, where all n have σ²/n.
        draws.append(np.sqrt(half / (2.0 * count)) * (found[0] - found[1]))
        means.append(0.5 * (found[0] + found[1]))
        advance()
    here = np.array([effects.point.physics.values[name] for name in names])
    others = (
        np.array([[_value(physics, name) for name in names] for physics in effects.resampled(_CHOICE_DRAWS)]) - here
    )
    by_choice = others.T @ others / len(others)
    return Spread(names, np.mean(means, axis=0), np.array(draws), by_choice, min(len(draws), count - 1), count)


def _found_by(
    data: DataSet, which: NDArray[np.int64], points: tuple[Linearisation, ...], rng: np.random.Generator
) -> Array:
    """The free parameters that some of the throws find: from where their own normal equations lead, and from starts anew."""
    part, physics = data.some(which), points[0].physics
    starts = [_physics_drawn(physics, rng) for _ in range(_HALF_STARTS)]
    starts += [point.moved(which) for point in points]
    ends = sorted((minimised(part, start, NEARLY_CONVERGED) for start in starts), key=lambda point: point.cost)
    best = minimised(part, ends[0].physics).physics
    return np.array([best.values[name] for name in physics.free])


def _value(physics: Physics, name: str) -> float:
    """Of a parameter, in use or not."""
    return physics.values[name] if name in physics.values else physics.neutral(name)


def _divisions(count: int) -> int:
    """Different divisions of few throws into halves."""
    return 1 if count == 2 else (3 if count == 3 else SPLITS)


def _starts(physics: Physics) -> list[Physics]:
    """The physics at hand, and others drawn over the usual range of each free parameter."""
    rng, starts = np.random.default_rng(0), [physics]
    for _ in range(STARTS - 1 if len(physics.free) > 1 else 2):
        starts.append(_physics_drawn(physics, rng))
    return starts


def _physics_drawn(physics: Physics, rng: np.random.Generator) -> Physics:
    """The physics with each free parameter drawn over its usual range."""
    return physics.with_values(**{name: _drawn(physics, name, rng) for name in physics.free})


def _drawn(physics: Physics, name: str, rng: np.random.Generator) -> float:
    if name == "corner_radius_m":
        return float(rng.uniform(*_RADII)) * physics.die.solid.inradius
    if name in ("chi_fade_s_per_m", "mu_fade_s_per_m"):
        return float(np.exp(rng.uniform(*np.log(_FADES_S_PER_M))))
    return physics.values[name] * float(np.exp(rng.uniform(*np.log(_RANGES[name]))))


def _are_one(one: Physics, other: Physics) -> bool:
    """Whether two points belong to one minimum."""
    return all(abs(one.values[n] - other.values[n]) <= _SAME_STEPS * step_of(one, n) for n in one.free)
