"""How far a die can be predicted: sensitivity of the final configuration, and fairness by dynamics.

The paper's two definitions (Kapitaniak et al., Chaos 22, 047504, 2012): a throw is *predictable* if for almost all
initial conditions x0 there is an open set about x0 that is mapped into one final configuration; a die is *fair by
dynamics* if in the neighbourhood of any initial condition there are sets β(F1) ... β(Fn) of conditions that lead to the
n final configurations, with measures of 1/n each. Both speak of arbitrarily small neighbourhoods, so that both are
measured over decades of a size ε:

- **Decided at ε.** A condition is certain at ε if it and its neighbours at ±ε along every axis end in the same
  configuration. The share f(ε) of uncertain conditions falls to zero with ε where a die is predictable, and the largest
  ε up to which a condition stays certain is what one must know it to.
- **Uncertainty exponent.** f(ε) ~ ε^α, and D = d - α is the dimension of the basins' boundary in a space of d
  dimensions (McDonald, Grebogi, Ott, Yorke, Physica D 17, 125, 1985): α = 1 for a smooth boundary; the nearer to 0, the
  less does it help to know the initial condition better.
- **Measures β.** Of the ball of radius ε about a condition, by drawing from it, with Pearson's χ² against 1/n.

Outcomes are a function from conditions (n, d) to whole numbers (n,): faces are 1, 2, ...; anything else is no face.
Sizes ε are shares of a scale per axis, for instance the sides of a window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from .landings import chunks_in_order
from .odds import Share

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Outcome = Callable[[Array], Indices]

GROUPS = 32
"""Equal groups into which conditions are divided, for the standard error by leaving one out."""
FEWEST = 10
"""Uncertain conditions without which a share says too little of a slope."""
SMALL = 0.15
"""Part of the chance level up to which f(ε) is taken for a power of ε."""


@dataclass(frozen=True, eq=False)
class FinalStateSensitivity:
    """How often neighbours at a distance end elsewhere. Whole numbers, per group of conditions."""

    epsilons: Array
    """(k,) sizes, ascending, in shares of the scales."""
    dimensions: int
    """d, of the conditions."""
    conditions: int
    """Conditions in each group."""
    uncertain: Indices
    """(GROUPS, k) of them whose neighbours at each size do not all end as they do."""
    decided: Indices
    """(k + 1,) conditions that are certain up to each size and no farther; the first: at none."""
    chance: float
    """The share that would be uncertain if neighbours had nothing to do with each other."""

    @property
    def shares(self) -> tuple[Share, ...]:
        """f(ε), with intervals."""
        return tuple(Share(int(n), GROUPS * self.conditions) for n in self.uncertain.sum(0))

    def deciding_epsilon(self, share: float = 0.5) -> float | None:
        """The largest size up to which at least this share of the conditions is certain; None if it is none."""
        # certain[k]: conditions that are certain at epsilons[k] and at every smaller size.
        certain = self.decided[::-1].cumsum()[::-1][1:] / self.decided.sum()
        enough = np.flatnonzero(certain >= share)
        return float(self.epsilons[enough[-1]]) if len(enough) else None


@dataclass(frozen=True)
class UncertaintyExponent:
    """The slope of log f against log ε: f(ε) = prefactor × ε^value over the range it was taken from."""

    value: float
    standard_error: float
    """By leaving out one group of conditions at a time (jackknife): f at different ε go together."""
    epsilon_from: float
    epsilon_to: float
    """The range over which the slope was taken."""
    prefactor: float
    dimensions: int

    @property
    def boundary_dimension(self) -> float:
        """D = d - α."""
        return self.dimensions - self.value


@dataclass(frozen=True, eq=False)
class Fairness:
    """What the balls about one condition lead to."""

    condition: Array
    """(d,)"""
    epsilons: Array
    """(k,)"""
    counts: Indices
    """(k, faces) throws of each ball that end on each face."""
    none: Indices
    """(k,) that end on no face."""

    @property
    def measures(self) -> Array:
        """(k, faces) β of each face: its share of the throws that end on one; NaN where none does."""
        landed = self.counts.sum(1, keepdims=True)
        return np.divide(self.counts, landed, out=np.full(self.counts.shape, np.nan), where=landed > 0)

    @property
    def chi_square(self) -> Array:
        """(k,) Pearson's statistic of the counts against equal ones; 0 where nothing landed."""
        mean = self.counts.mean(1, keepdims=True)
        return np.asarray(
            np.divide((self.counts - mean) ** 2, mean, out=np.zeros(self.counts.shape), where=mean > 0).sum(1)
        )

    @property
    def p_value(self) -> Array:
        """(k,) probability of such a statistic or a larger one, if the measures were equal."""
        return np.asarray(chi2.sf(self.chi_square, self.counts.shape[1] - 1))


def final_state_sensitivity(
    outcome: Outcome,
    low: ArrayLike,
    high: ArrayLike,
    epsilons: Sequence[float],
    *,
    conditions: int = 2048,
    seed: int = 0,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> FinalStateSensitivity:
    """How conditions drawn uniformly between `low` and `high` (d,) end, and their neighbours at each of `epsilons`.

    A size of 1 is the distance from low to high along each axis. `conditions` is rounded up to a multiple of GROUPS;
    each costs 1 + 2 d k throws. The result does not depend on `threads`.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    sizes = np.sort(_checked_sizes(epsilons))
    each = -(-conditions // GROUPS)
    offsets = _neighbours(sizes, high - low)

    def work(group: int, _: int) -> tuple[Indices, Indices, Indices]:
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(group,))))
        points = low + (high - low) * random.random((each, len(low)))
        ends = outcome(points)
        around = outcome((points[:, None, None] + offsets).reshape(-1, len(low))).reshape(each, len(sizes), -1)
        certain = (around == ends[:, None, None]).all(2)
        reach = np.logical_and.accumulate(certain, axis=1).sum(1)
        return (~certain).sum(0), np.bincount(reach, minlength=len(sizes) + 1), ends

    uncertain, decided = np.zeros((GROUPS, len(sizes)), np.int64), np.zeros(len(sizes) + 1, np.int64)
    ends = []
    for group, done, part in chunks_in_order(work, 0, GROUPS, 1, threads):
        uncertain[group] = part[0]
        decided += part[1]
        ends.append(part[2])
        if progress:
            progress(done, GROUPS)
    shares = np.unique(np.concatenate(ends), return_counts=True)[1] / (GROUPS * each)
    chance = 1.0 - float((shares ** (1 + 2 * len(low))).sum())
    return FinalStateSensitivity(sizes, len(low), each, uncertain, decided, chance)


def uncertainty_exponent(sensitivity: FinalStateSensitivity) -> UncertaintyExponent | None:
    """α of f(ε) ~ ε^α, by weighted least squares of log f on log ε.

    The exponent is a limit of small ε. So sizes count at which at least FEWEST conditions are uncertain, and f is no
    more than SMALL of what chance would make it: beyond that it bends towards that level. None where fewer than three
    sizes are left.
    """
    total = sensitivity.uncertain.sum(0)
    throws = GROUPS * sensitivity.conditions
    serves = (total >= FEWEST) & (total <= SMALL * sensitivity.chance * throws)
    if serves.sum() < 3:
        return None
    x, counts = np.log(sensitivity.epsilons[serves]), sensitivity.uncertain[:, serves]
    # The variance of log f is (1 - f)/(n f), from that of a binomial count.
    weights = total[serves] / (1.0 - total[serves] / throws)
    slope = _slope(x, np.log(total[serves]), weights)
    left_out = np.maximum(total[serves] - counts, 0.5)  # a group may hold every uncertain condition
    slopes = np.array([_slope(x, np.log(row), weights) for row in left_out])
    error = float(np.sqrt((GROUPS - 1) * np.mean((slopes - slopes.mean()) ** 2)))
    ends = sensitivity.epsilons[serves]
    level = np.average(np.log(total[serves] / throws) - slope * x, weights=weights)
    return UncertaintyExponent(
        slope, error, float(ends[0]), float(ends[-1]), float(np.exp(level)), sensitivity.dimensions
    )


def fairness_by_dynamics(
    outcome: Outcome,
    condition: ArrayLike,
    scales: ArrayLike,
    faces: int,
    epsilons: Sequence[float],
    *,
    throws: int = 1000,
    seed: int = 0,
) -> Fairness:
    """What conditions drawn uniformly from the ball about `condition` (d,) lead to, for each radius of `epsilons`.

    A radius of 1 is `scales` (d,) along each axis. `throws` are made per radius; `faces` are those of the die.
    """
    condition, scales = np.asarray(condition, float), np.asarray(scales, float)
    sizes = np.sort(_checked_sizes(epsilons))
    counts, none = np.zeros((len(sizes), faces), np.int64), np.zeros(len(sizes), np.int64)
    for k, size in enumerate(sizes):
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(k,))))
        ways = random.normal(size=(throws, len(condition)))
        ways *= random.random((throws, 1)) ** (1.0 / len(condition)) / np.linalg.norm(ways, axis=1, keepdims=True)
        ends = outcome(condition + size * scales * ways)
        counts[k] = np.bincount(ends[ends > 0], minlength=faces + 1)[1:]
        none[k] = int((ends <= 0).sum())
    return Fairness(condition, sizes, counts, none)


def _neighbours(sizes: Array, scales: Array) -> Array:
    """Offsets (k, 2 d, d) of the neighbours at each size."""
    steps = np.diag(scales)
    return np.asarray(sizes[:, None, None] * np.concatenate([steps, -steps]))


def _slope(x: Array, y: Array, weights: Array) -> float:
    away = x - np.average(x, weights=weights)
    return float((weights * away) @ y / ((weights * away) @ away))


def _checked_sizes(epsilons: Sequence[float]) -> Array:
    sizes = np.asarray(epsilons, float)
    if sizes.ndim != 1 or not len(sizes) or not (np.isfinite(sizes) & (sizes > 0)).all():
        raise ValueError(f"epsilons = {list(epsilons)}: wanted sizes above 0")
    return sizes
