"""How far a die can be predicted: sensitivity of the final configuration, and fairness by dynamics.

Kapitaniak et al. (Chaos 22, 047504, 2012) define both. A throw is *predictable* if for almost all initial conditions x0
there is an open set about x0 that is mapped into one final configuration. A die is *fair by dynamics* if in the
neighbourhood of any initial condition there are sets β(F1) ... β(Fn) of conditions that lead to the n final
configurations, with measures of 1/n each. Both concern arbitrarily small neighbourhoods, so both are measured over
decades of a size ε:

- **Certain at ε.** A condition is certain at ε if it and its neighbours at ±ε along every axis end in the same
  configuration. For a predictable die the fraction f(ε) of uncertain conditions falls to zero with ε. The largest ε up
  to which a condition is certain is the accuracy to which it must be known.
- **Uncertainty exponent.** f(ε) ~ ε^α, and D = d - α is the dimension of the basin boundary in a space of d dimensions
  (McDonald, Grebogi, Ott, Yorke, Physica D 17, 125, 1985). A smooth boundary has α = 1. The closer α is to 0, the less
  a better knowledge of the initial condition helps.
- **Measures β** of the ball of radius ε about a condition, by sampling it, with Pearson's χ² against 1/n.

Outcomes are a function from conditions (n, d) to whole numbers (n,): faces are 1, 2, ...; any other number is no face.
Sizes ε are fractions of a scale per axis, for instance the sides of a window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

from ..errors import InputError
from .landings import chunks_in_order
from .odds import Share

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Outcome = Callable[[Array], Indices]

JACKKNIFE_GROUPS = 32
"""Equal groups of conditions, of which the jackknife leaves out one at a time. More groups give a better standard error, and
more generators to seed."""

MIN_UNCERTAIN = 10
"""Least number of uncertain conditions at a size that enters the slope: with fewer, log f has an error above 0.3."""

MAX_CHANCE_FRACTION = 0.15
"""Largest f(ε) that is treated as a power of ε, as a fraction of the level of independent neighbours, towards which f bends.
A higher limit admits more sizes and biases the slope."""

MIN_SIZES = 3
"""Least number of sizes for a slope with a standard error."""


@dataclass(frozen=True, eq=False)
class FinalStateSensitivity:
    """How often neighbours end in another configuration, counted in each group of conditions."""

    epsilons: Array
    """(k,) sizes, ascending, as fractions of the scales."""
    dimensions: int
    """d, the number of axes."""
    conditions: int
    """Number of conditions in each group."""
    uncertain: Indices
    """(JACKKNIFE_GROUPS, k) conditions with a neighbour at each size that ends differently."""
    decided: Indices
    """(k + 1,) conditions that are certain up to each size and not beyond; the first number counts those certain at none."""
    chance: float
    """The fraction that would be uncertain if the outcomes of neighbours were independent."""

    @property
    def shares(self) -> tuple[Share, ...]:
        """f(ε), with intervals."""
        return tuple(Share(int(n), JACKKNIFE_GROUPS * self.conditions) for n in self.uncertain.sum(0))

    def deciding_epsilon(self, share: float = 0.5) -> float | None:
        """The largest size up to which at least this fraction of the conditions is certain; None if there is no such size."""
        # certain[k] is the fraction of conditions certain at epsilons[k] and at every smaller size.
        certain = self.decided[::-1].cumsum()[::-1][1:] / self.decided.sum()
        enough = np.flatnonzero(certain >= share)
        return float(self.epsilons[enough[-1]]) if len(enough) else None


@dataclass(frozen=True)
class UncertaintyExponent:
    """The slope of log f against log ε: f(ε) = prefactor × ε^value over the fitted range."""

    value: float
    standard_error: float
    """By the jackknife over groups of conditions, because f at different ε are correlated."""
    epsilon_from: float
    epsilon_to: float
    """The fitted range."""
    prefactor: float
    dimensions: int

    @property
    def boundary_dimension(self) -> float:
        """D = d - α."""
        return self.dimensions - self.value


@dataclass(frozen=True, eq=False)
class Fairness:
    """Outcomes of the balls about one condition."""

    condition: Array
    """(d,)"""
    epsilons: Array
    """(k,)"""
    counts: Indices
    """(k, faces) throws from each ball that end on each face."""
    none: Indices
    """(k,) throws from each ball that end on no face."""

    @property
    def measures(self) -> Array:
        """(k, faces) β of each face, its fraction of the throws that end on a face; NaN if none does."""
        landed = self.counts.sum(1, keepdims=True)
        return np.divide(self.counts, landed, out=np.full(self.counts.shape, np.nan), where=landed > 0)

    @property
    def chi_square(self) -> Array:
        """(k,) Pearson's statistic of the counts against equal counts; 0 if nothing landed."""
        mean = self.counts.mean(1, keepdims=True)
        return np.asarray(
            np.divide((self.counts - mean) ** 2, mean, out=np.zeros(self.counts.shape), where=mean > 0).sum(1)
        )

    @property
    def p_value(self) -> Array:
        """(k,) probability of such a statistic or a larger one under equal measures."""
        return np.asarray(chdtrc(self.counts.shape[1] - 1, self.chi_square))


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

    A size of 1 is the distance from low to high along each axis. `conditions` is rounded up to a multiple of
    JACKKNIFE_GROUPS, and each takes 1 + 2 d k throws. The result does not depend on `threads`.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    sizes = np.sort(_checked_sizes(epsilons))
    each = -(-conditions // JACKKNIFE_GROUPS)
    offsets = _neighbours(sizes, high - low)

    def work(group: int, _: int) -> tuple[Indices, Indices, Indices]:
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(group,))))
        points = low + (high - low) * random.random((each, len(low)))
        ends = outcome(points)
        around = outcome((points[:, None, None] + offsets).reshape(-1, len(low))).reshape(each, len(sizes), -1)
        certain = (around == ends[:, None, None]).all(2)
        reach = np.logical_and.accumulate(certain, axis=1).sum(1)
        return (~certain).sum(0), np.bincount(reach, minlength=len(sizes) + 1), ends

    uncertain, decided = np.zeros((JACKKNIFE_GROUPS, len(sizes)), np.int64), np.zeros(len(sizes) + 1, np.int64)
    ends = []
    for group, done, part in chunks_in_order(work, 0, JACKKNIFE_GROUPS, 1, threads):
        uncertain[group] = part[0]
        decided += part[1]
        ends.append(part[2])
        if progress:
            progress(done, JACKKNIFE_GROUPS)
    shares = np.unique(np.concatenate(ends), return_counts=True)[1] / (JACKKNIFE_GROUPS * each)
    chance = 1.0 - float((shares ** (1 + 2 * len(low))).sum())
    return FinalStateSensitivity(sizes, len(low), each, uncertain, decided, chance)


def uncertainty_exponent(sensitivity: FinalStateSensitivity) -> UncertaintyExponent | None:
    """α of f(ε) ~ ε^α, by weighted least squares of log f on log ε.

    The exponent is a limit of small ε. The fit takes the sizes at which at least MIN_UNCERTAIN conditions are uncertain and
    f is at most MAX_CHANCE_FRACTION of the level of independent neighbours. None if fewer than MIN_SIZES sizes are left.
    """
    total = sensitivity.uncertain.sum(0)
    throws = JACKKNIFE_GROUPS * sensitivity.conditions
    used = (total >= MIN_UNCERTAIN) & (total <= MAX_CHANCE_FRACTION * sensitivity.chance * throws)
    if used.sum() < MIN_SIZES:
        return None
    x, counts = np.log(sensitivity.epsilons[used]), sensitivity.uncertain[:, used]
    # The variance of log f is (1 - f)/(n f), from that of a binomial count.
    weights = total[used] / (1.0 - total[used] / throws)
    slope = _slope(x, np.log(total[used]), weights)
    left_out = np.maximum(total[used] - counts, 0.5)  # a group may hold every uncertain condition
    slopes = np.array([_slope(x, np.log(row), weights) for row in left_out])
    error = float(np.sqrt((JACKKNIFE_GROUPS - 1) * np.mean((slopes - slopes.mean()) ** 2)))
    ends = sensitivity.epsilons[used]
    level = np.average(np.log(total[used] / throws) - slope * x, weights=weights)
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
    """Outcomes of conditions drawn uniformly from the ball about `condition` (d,), for each radius of `epsilons`.

    A radius of 1 is `scales` (d,) along each axis. `throws` are made per radius; `faces` is the number of faces of the die.
    """
    condition, scales = np.asarray(condition, float), np.asarray(scales, float)
    sizes = np.sort(_checked_sizes(epsilons))
    counts, none = np.zeros((len(sizes), faces), np.int64), np.zeros(len(sizes), np.int64)
    for k, size in enumerate(sizes):
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(k,))))
        offsets = random.normal(size=(throws, len(condition)))
        offsets *= random.random((throws, 1)) ** (1.0 / len(condition)) / np.linalg.norm(offsets, axis=1, keepdims=True)
        ends = outcome(condition + size * scales * offsets)
        counts[k] = np.bincount(ends[ends > 0], minlength=faces + 1)[1:]
        none[k] = int((ends <= 0).sum())
    return Fairness(condition, sizes, counts, none)


def _neighbours(sizes: Array, scales: Array) -> Array:
    """Offsets (k, 2 d, d) of the neighbours at each size, along both directions of every axis."""
    steps = np.diag(scales)
    return np.asarray(sizes[:, None, None] * np.concatenate([steps, -steps]))


def _slope(x: Array, y: Array, weights: Array) -> float:
    """Slope of the weighted regression of y on x."""
    centred = x - np.average(x, weights=weights)
    return float((weights * centred) @ y / ((weights * centred) @ centred))


def _checked_sizes(epsilons: Sequence[float]) -> Array:
    """The sizes (k,) as an array. Raises ValueError unless all are finite and above 0."""
    sizes = np.asarray(epsilons, float)
    if sizes.ndim != 1 or not len(sizes) or not (np.isfinite(sizes) & (sizes > 0)).all():
        raise InputError(f"epsilons = {list(epsilons)}: wanted sizes above 0")
    return sizes
