"""What the flights before the first bounce show of many throws, whatever the law of impact: centre of mass and clock.

While a die falls, its centroid circles the centre of mass, which falls by g c² t²/2 in the track's time t, with c the true
seconds in one of the track. Offset and c² - 1 are linear in the positions, which are projected off the straight line of each
flight. Neither is left to the impacts: where no law describes these to within the errors of the frames, a centre of mass or a
clock of a fit stands for what the law lacks.

Covariances are those of the throws left out one at a time (jackknife), or of the frames' scatter where that is more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from ...model.rotations import matrix_from_quat
from ..estimation import normal_quantile
from ..results import Effect
from ..throw import CENTRE_OF_MASS, INTERVAL_LEVEL, Physics
from .data_set import Entry

Array = NDArray[np.float64]

FLIGHT_EFFECTS: dict[str, tuple[str, ...]] = {"clock": ("clock_scale",), "loaded die": CENTRE_OF_MASS}
"""Effects that flights decide, and their parameters, in the order in which they are looked for."""


_LEAST_CLOCK_ERROR = 1e-6
"""Standard error of a clock below which rounding of the times shows."""


@dataclass(frozen=True, eq=False)
class FlightEstimate:
    """Parameters of one effect, estimated from flights."""

    values: Array
    """(k,) in the order of `FLIGHT_EFFECTS`."""
    covariance: Array
    """(k, k)."""
    neutral: Array
    """(k,) values without effect."""
    throws: int

    @property
    def evidence(self) -> float:
        """Units of log-likelihood by which the flights prefer these values to the neutral ones."""
        off = self.values - self.neutral
        return 0.5 * float(off @ np.linalg.solve(self.covariance, off))

    @property
    def half_widths(self) -> Array:
        """(k,) of the intervals."""
        many = self.throws > 2
        factor = stdtrit(self.throws - 1, 0.5 + 0.5 * INTERVAL_LEVEL) if many else normal_quantile(INTERVAL_LEVEL)
        return np.asarray(factor * np.sqrt(np.diag(self.covariance)))


def with_flight_effects(
    entries: Sequence[Entry], physics: Physics, effects: Sequence[str], least_evidence: Callable[[int], float]
) -> tuple[Physics, dict[str, FlightEstimate], list[Effect], list[Effect]]:
    """The physics with those of `effects` that the flights show, held at their values; the estimates of these; the effects
    accepted and those refused. `least_evidence` is what k parameters must have."""
    found: dict[str, FlightEstimate] = {}
    accepted, refused = [], []
    for effect, names in FLIGHT_EFFECTS.items():
        if effect not in effects or not physics.can_be_thrown_with(effect):
            continue
        estimate = clock_from_flights(entries, physics) if effect == "clock" else offset_from_flights(entries, physics)
        off = np.abs(estimate.values - estimate.neutral)
        limits = np.array([physics.calibration_limit(name) for name in names])
        if estimate.evidence <= least_evidence(len(names)):
            why = f"The flights before the first bounce show none: {_in_words(names, estimate)}."
        elif (off <= limits).all():
            why = f"Its size ({_in_words(names, estimate)}) is within what calibration and manufacture leave open."
        else:
            values = dict(zip(names, estimate.values.tolist(), strict=True))
            physics = physics.with_values(**values)
            for name in names:
                physics = physics.holding(name, physics.values[name])
            found[effect] = estimate
            accepted.append(Effect(effect, estimate.evidence, None))
            continue
        refused.append(Effect(effect, estimate.evidence, why))
    return physics, found, accepted, refused


def offset_from_flights(entries: Sequence[Entry], physics: Physics) -> FlightEstimate:
    """The centre of mass (3,) [m] from the centroid, body axes. `free.loaded_die` finds it from all flights of one throw."""
    equations = [_normal_equations(entry, physics.clock, with_clock=False) for entry in entries]
    values, covariance = _solution(equations)
    return FlightEstimate(values, covariance, np.zeros(3), len(entries))


def clock_from_flights(entries: Sequence[Entry], physics: Physics) -> FlightEstimate:
    """True seconds in a second of the tracks."""
    equations = [_normal_equations(entry, 1.0, with_clock=True) for entry in entries]
    values, covariance = _solution(equations)
    fall = physics.table.gravity_m_s2 * physics.length
    clock = float(np.sqrt(max(1.0 + values[3] / fall, 1e-6)))
    error = max(0.5 * float(np.sqrt(covariance[3, 3])) / (fall * clock), _LEAST_CLOCK_ERROR)
    return FlightEstimate(np.array([clock]), np.array([[error**2]]), np.ones(1), len(entries))


def _in_words(names: Sequence[str], estimate: FlightEstimate) -> str:
    errors = np.sqrt(np.diag(estimate.covariance))
    parts = [f"{n} {v:.4g} ± {e:.2g}" for n, v, e in zip(names, estimate.values, errors, strict=True)]
    return ", ".join(parts)


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of one flight, for errors of standard deviation 1."""

    matrix: Array
    right: Array
    squares: float
    freedom: int


def _solution(equations: Sequence[_Equations]) -> tuple[Array, Array]:
    """Values (k,) and their covariance (k, k)."""
    matrix, right = sum(e.matrix for e in equations), sum(e.right for e in equations)
    values = np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0], dtype=np.float64)
    freedom = max(sum(e.freedom for e in equations) - len(values), 1)
    unexplained = sum(e.squares for e in equations) - float(right @ values)
    covariance = np.asarray(max(1.0, unexplained / freedom) * np.linalg.pinv(matrix, rcond=1e-12), dtype=np.float64)
    count = len(equations)
    if count <= 2:
        return values, covariance
    without = np.array(
        [np.linalg.lstsq(matrix - e.matrix, right - e.right, rcond=1e-12)[0] - values for e in equations]
    )
    jackknife = np.asarray((count - 1) / count * without.T @ without, dtype=np.float64)
    return values, jackknife if np.trace(jackknife) > np.trace(covariance) else covariance


def _normal_equations(entry: Entry, clock: float, *, with_clock: bool) -> _Equations:
    """Of the offset (3,) and, `with_clock`, of the change of g."""
    rows, state = entry.release.rows, entry.release.fair_state
    times = entry.track.time_s[rows] - state.time_s
    line = np.stack([np.ones_like(times), times], 1)
    off_line = np.eye(len(rows)) - line @ np.linalg.pinv(line)
    columns = -np.einsum("mn,nij->mij", off_line, matrix_from_quat(entry.track.quaternion[rows])).reshape(-1, 3)
    if with_clock:
        fall = np.zeros((len(rows), 3))
        fall[:, 2] = -0.5 * (off_line @ times**2)
        columns = np.column_stack([columns, fall.ravel()])
    flown = state.position_m + np.outer(times, state.velocity_m_s)
    flown[:, 2] -= 0.5 * entry.track.gravity_m_s2 * (clock * times) ** 2
    left = (off_line @ (entry.track.position_m[rows] - flown)).ravel() / entry.release.sigma_m
    columns = columns / entry.release.sigma_m
    return _Equations(columns.T @ columns, columns.T @ left, float(left @ left), max(3 * len(rows) - 6, 0))
