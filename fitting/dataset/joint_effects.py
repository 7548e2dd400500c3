"""Effects that throws share, accepted if they predict throws better that are left out of the fit.

Effects are added to the paper's law one at a time (`throw.effects` does the same for one throw). The throws are divided
into five folds. Each is predicted with parameters from the other folds: one step of the same minimisation from the common
fit, by the normal equations of those throws. The effect that lowers the mean cost most is accepted if, compared throw by
throw, it does so by more than Student's t allows by chance. One that raises the cost by as much is not tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from ...model.rotations import matrix_from_quat
from ..results import Effect
from ..throw import CALIBRATION_LIMITS, CENTRE_OF_MASS, Physics
from .data_set import DataSet, Entry, data_set_of
from .minimisation import NEARLY_CONVERGED, Linearisation, left_out_residuals, linearised_at, minimised

Array = NDArray[np.float64]

EFFECTS: dict[str, tuple[str, ...]] = {
    "friction": ("mu",),
    "loaded die": CENTRE_OF_MASS,
    "rounded corners": ("corner_radius_m",),
    "inertia": ("inertia_kg_m2",),
    "fading restitution": ("chi_fade_s_per_m",),
    "fading friction": ("mu_fade_s_per_m",),
    "clock": ("clock_scale",),
}
"""Effects on trial and their parameters."""

_REQUIRED = {"fading friction": "mu"}
"""Parameters without which an effect does nothing."""

FIRST_CHI = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
"""χ from which fits may start, so that no start is asked for."""

_FIRST_MU = (0.1, 0.2, 0.4)
"""The same of friction."""

_FIRST_RADII = (0.02, 0.08, 0.2)
"""The same of corner radii, in inscribed radii."""

_FIRST_FADES_S_PER_M = (0.1, 1.0)
"""The same of fading restitution and friction."""

START_THROWS = 8
"""Throws by which such starts are compared."""

_CLOCK_SIGMAS = 4.0
"""Standard errors between a clock and that of the flights alone at which these refute it."""

_CONFIDENCE = 0.95
"""Confidence that an accepted effect lowers the cost."""


def with_effects(
    data: DataSet, point: Linearisation, effects: Sequence[str], on_trial: Callable[[], None]
) -> tuple[Linearisation, list[Effect], list[Effect]]:
    """Effects added while they are accepted, the one that lowers the cost most first; then those accepted and those refused.

    `on_trial` is called after every trial. What throws of this die cannot have is not tried.
    """
    accepted: list[Effect] = []
    left = [effect for effect in effects if point.physics.can_be_thrown_with(effect)]
    refused: dict[str, Effect] = {}
    while left:
        # How errors of the release state grow depends on the law: the slack is computed anew.
        data = data_set_of(data.entries, point.physics, data.pool)
        point = linearised_at(data, point.physics)
        before = data.costs(left_out_residuals(data, point))
        trials: dict[str, tuple[Linearisation, Array]] = {}
        for effect in left:
            if _REQUIRED.get(effect, "chi") not in point.physics.values:
                refused[effect] = Effect(
                    effect, None, f"Not tried: the model has no {_REQUIRED[effect]} that could fade."
                )
                continue
            wider = _with_one_more(data, point, effect)
            gains = before - data.costs(left_out_residuals(data, wider))
            on_trial()
            if (why := refuted_by_flights(wider.physics, data.entries)) is not None:
                refused[effect] = Effect(effect, _evidence(gains), why)
                continue
            trials[effect] = (wider, gains)
            refused[effect] = _refusal(effect, gains, before)
        better = [effect for effect, (_, gains) in trials.items() if gains.mean() > _required_gain(gains)]
        if not better:
            break
        best = max(better, key=lambda effect: float(trials[effect][1].mean()))
        point = trials[best][0]
        accepted.append(Effect(best, _evidence(trials[best][1]), None))
        worse = [effect for effect, (_, gains) in trials.items() if gains.mean() < -_required_gain(gains)]
        left = [effect for effect in left if effect != best and effect not in worse]
    names = {effect.name for effect in accepted}
    return point, accepted, [refused[effect] for effect in effects if effect in refused and effect not in names]


def offset_before_bounces(entries: Sequence[Entry]) -> Array:
    """The centre of mass (3,) [m] that the flights before the first bounce show: the one about which the centroid circles
    while it falls freely. `free.loaded_die` finds it from all flights of one throw, with their covariances."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for entry in entries:
        columns, left = _free_fall(entry)
        weight = 1.0 / entry.release.sigma_m**2
        matrix += weight * columns[:, :3].T @ columns[:, :3]
        right += weight * columns[:, :3].T @ left
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-9)[0], dtype=np.float64)


def refuted_by_flights(physics: Physics, entries: Sequence[Entry]) -> str | None:
    """Why the clock of a fit is refused, where free flights have another; None if they agree with it.

    In throws that no law predicts to within the errors of the frames, a clock can stand for what the law lacks.
    """
    if "clock_scale" not in physics.values:
        return None
    clock, error = clock_before_bounces(physics, entries)
    if abs(physics.clock - clock) <= _CLOCK_SIGMAS * np.hypot(error, CALIBRATION_LIMITS["clock_scale"]):
        return None
    return (
        f"Throws would be predicted best with a clock of {physics.clock:.4g}, but the flights before the first bounce fall "
        f"with g on one of {clock:.4f} ± {error:.4f}."
    )


def clock_before_bounces(physics: Physics, entries: Sequence[Entry]) -> tuple[float, float]:
    """True seconds in a second of the tracks, from how the die falls before the first bounce, and the standard error.

    In flight the centre of mass falls by g c² t²/2 in the track's time t, with c the clock. The three numbers of a
    centre-of-mass offset are fitted too, as in `offset_before_bounces`.
    """
    matrix, right, squares, freedom = np.zeros((4, 4)), np.zeros(4), 0.0, 0
    for entry in entries:
        columns, fallen = _free_fall(entry)
        weight = 1.0 / entry.release.sigma_m**2
        matrix += weight * columns.T @ columns
        right += weight * columns.T @ fallen
        squares += weight * float(fallen @ fallen)
        freedom += 3 * len(entry.release.rows) - 6
    values = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    variance = max(1.0, (squares - float(right @ values)) / max(freedom - 4, 1))
    squared = 1.0 + float(values[3]) / (physics.table.gravity_m_s2 * physics.length)
    error = float(np.sqrt(variance * np.linalg.pinv(matrix)[3, 3])) / (physics.table.gravity_m_s2 * physics.length)
    clock = float(np.sqrt(max(squared, 1e-6)))
    return clock, 0.5 * error / clock


def _free_fall(entry: Entry) -> tuple[Array, Array]:
    """Derivatives (3 n, 4) of the positions of one flight by a centre-of-mass offset (3,) and by gravity, and the residuals
    (3 n,), all projected off straight lines."""
    rows, state = entry.release.rows, entry.release.fair_state
    times = entry.track.time_s[rows] - state.time_s
    line = np.stack([np.ones_like(times), times], 1)
    off_line = np.eye(len(rows)) - line @ np.linalg.pinv(line)
    circled = -np.einsum("mn,nij->mij", off_line, matrix_from_quat(entry.track.quaternion[rows])).reshape(-1, 3)
    fall = np.zeros((len(rows), 3))
    fall[:, 2] = -0.5 * (off_line @ times**2)
    flown = state.position_m + np.outer(times, state.velocity_m_s)
    flown[:, 2] -= 0.5 * entry.track.gravity_m_s2 * times**2
    left = off_line @ (entry.track.position_m[rows] - flown)
    return np.column_stack([circled, fall.ravel()]), left.ravel()


def _with_one_more(data: DataSet, point: Linearisation, effect: str) -> Linearisation:
    """The fit with one more effect, from the best of a few starts."""
    physics = point.physics.with_values(**{name: point.physics.neutral(name) for name in EFFECTS[effect]})
    starts = _starts(physics, effect, data.entries)
    best = min(starts, key=data.subset(START_THROWS).mean_cost) if len(starts) > 1 else starts[0]
    return minimised(data, best, NEARLY_CONVERGED)


def _starts(physics: Physics, effect: str, entries: Sequence[Entry]) -> list[Physics]:
    if effect == "friction":
        return [physics.with_values(mu=mu, chi=chi) for mu in _FIRST_MU for chi in FIRST_CHI[:-1]]
    if effect == "rounded corners":
        return [physics.with_values(corner_radius_m=part * physics.die.solid.inradius) for part in _FIRST_RADII]
    if effect == "loaded die":
        offset = dict(zip(CENTRE_OF_MASS, offset_before_bounces(entries).tolist(), strict=True))
        return [physics, physics.with_values(**offset)]
    if effect in ("fading restitution", "fading friction"):
        return [physics.with_values(**{EFFECTS[effect][0]: fade}) for fade in _FIRST_FADES_S_PER_M]
    return [physics]


def _required_gain(gains: Array) -> float:
    """The mean that gains (throws,) exceed by chance with odds of 1 - `_CONFIDENCE`."""
    return float(stdtrit(len(gains) - 1, _CONFIDENCE) * gains.std(ddof=1) / np.sqrt(len(gains)))


def _evidence(gains: Array) -> float:
    """Units of log-likelihood by which left-out throws are predicted better, for a normally distributed mean gain."""
    error = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return 0.5 * (float(gains.mean()) / max(error, 1e-300)) ** 2 * float(np.sign(gains.mean()))


def _refusal(effect: str, gains: Array, before: Array) -> Effect:
    share, error = gains.mean() / before.mean(), gains.std(ddof=1) / np.sqrt(len(gains)) / before.mean()
    if gains.mean() <= 0.0:
        why = f"It increases the prediction error of throws left out of the fit, by {-100 * share:.2g} %."
    else:
        why = (
            f"It reduces the prediction error of throws left out of the fit by {100 * share:.2g} %, with a standard error "
            f"of {100 * error:.2g} %: no more than chance."
        )
    return Effect(effect, _evidence(gains), why)
