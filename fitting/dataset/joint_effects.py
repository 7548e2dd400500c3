"""Which effects throws share: those with which throws are foretold better that were not in the fit.

From the paper's law on, one at a time (`selection` does the same for one throw). Throws are dealt into five folds, and
each is foretold with parameters fitted to the other folds (one step of the same method from the common fit, by the blocks
of those throws). The effect that lowers the cost of throws most is taken in if, compared throw by throw, it does so by
more than Student's t allows chance; one that raises it by as much is not asked again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from ...model.rotations import matrix_from_quat
from ...model.world import GRAVITY_M_S2
from ..results import Effect
from ..throw import LEAST_OF_CALIBRATION, LOAD, Physics
from .data_set import Crowd, Entry, crowd_of
from .least_cost import CONVERGED_ENOUGH, Point, descended, left_out_misses, seen_from

Array = NDArray[np.float64]

EFFECTS: dict[str, tuple[str, ...]] = {
    "friction": ("mu",),
    "loaded die": LOAD,
    "rounded corners": ("corner_radius_m",),
    "inertia": ("inertia_kg_m2",),
    "fading restitution": ("chi_fade_s_per_m",),
    "fading friction": ("mu_fade_s_per_m",),
    "clock": ("clock_scale",),
}
"""Effects on trial and their parameters."""

_NEEDS = {"fading friction": "mu"}
"""Parameters without which an effect is none."""

FIRST_CHI = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
_FIRST_MU = (0.1, 0.2, 0.4)
_FIRST_RADII = (0.02, 0.08, 0.2)
"""Of the inscribed radius."""
_FIRST_FADES_S_PER_M = (0.1, 1.0)
"""Where fits look first, so that no start is asked for."""

FOR_FIRST = 8
"""Throws by which such values are compared."""

_CONTRADICTED = 4.0
"""Standard errors by which a clock misses that of the flights alone where these refute it."""

_SURE = 0.95
"""Confidence with which an effect must pay."""


def with_effects(
    crowd: Crowd, point: Point, effects: Sequence[str], step: Callable[[], None]
) -> tuple[Point, list[Effect], list[Effect]]:
    """Effects taken in while they pay, the one that pays most first; then what was chosen and what was not. `step` is
    called after every trial."""
    chosen: list[Effect] = []
    left = list(effects)
    refused: dict[str, Effect] = {}
    while left:
        # What errors of the start do depends on the law: tell it anew.
        crowd = crowd_of(crowd.entries, point.physics, crowd.pool)
        point = seen_from(crowd, point.physics)
        before = crowd.costs(left_out_misses(crowd, point))
        trials: dict[str, tuple[Point, Array]] = {}
        for effect in left:
            if _NEEDS.get(effect, "chi") not in point.physics.values:
                refused[effect] = Effect(effect, None, f"Not tried: there is no {_NEEDS[effect]} for it to act on.")
                continue
            wider = _widened(crowd, point, effect)
            gains = before - crowd.costs(left_out_misses(crowd, wider))
            step()
            if (why := refuted_by_flights(wider.physics, crowd.entries)) is not None:
                refused[effect] = Effect(effect, _evidence(gains), why)
                continue
            trials[effect] = (wider, gains)
            refused[effect] = _refusal(effect, gains, before)
        paying = [effect for effect, (_, gains) in trials.items() if gains.mean() > _price(gains)]
        if not paying:
            break
        best = max(paying, key=lambda effect: float(trials[effect][1].mean()))
        point = trials[best][0]
        chosen.append(Effect(best, _evidence(trials[best][1]), None))
        hopeless = [effect for effect, (_, gains) in trials.items() if gains.mean() < -_price(gains)]
        left = [effect for effect in left if effect != best and effect not in hopeless]
    taken = {effect.name for effect in chosen}
    return point, chosen, [refused[effect] for effect in effects if effect in refused and effect not in taken]


def load_before_bounces(entries: Sequence[Entry]) -> Array:
    """The centre of mass (3,) [m] that the flights before the first bounce show: the one about which the centroid
    circles while it falls freely. `loaded` asks the same of all flights of one throw, with their covariances."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for entry in entries:
        columns, left = _free_fall(entry)
        weight = 1.0 / entry.outset.sigma_m**2
        matrix += weight * columns[:, :3].T @ columns[:, :3]
        right += weight * columns[:, :3].T @ left
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-9)[0], dtype=np.float64)


def refuted_by_flights(physics: Physics, entries: Sequence[Entry]) -> str | None:
    """Why the clock of a fit cannot be, where what flies free has another; None where nothing speaks against it.

    In throws that no law foretells to within the errors of the frames, a clock can stand for what the law lacks.
    """
    if "clock_scale" not in physics.values:
        return None
    clock, error = clock_before_bounces(physics, entries)
    if abs(physics.clock - clock) <= _CONTRADICTED * np.hypot(error, LEAST_OF_CALIBRATION["clock_scale"]):
        return None
    return (
        f"Throws would be foretold best with a clock of {physics.clock:.4g}, but the flights before the first bounce fall "
        f"with g on one of {clock:.4f} ± {error:.4f}."
    )


def clock_before_bounces(physics: Physics, entries: Sequence[Entry]) -> tuple[float, float]:
    """True seconds in one of the tracks, from how the die falls before the first bounce, and its standard error.

    In flight the centre of mass falls by g c² t²/2 in the track's time t, with c the clock; the three numbers of a load
    are fitted beside it, as in `load_before_bounces`.
    """
    matrix, right, squares, freedom = np.zeros((4, 4)), np.zeros(4), 0.0, 0
    for entry in entries:
        columns, fallen = _free_fall(entry)
        weight = 1.0 / entry.outset.sigma_m**2
        matrix += weight * columns.T @ columns
        right += weight * columns.T @ fallen
        squares += weight * float(fallen @ fallen)
        freedom += 3 * len(entry.outset.rows) - 6
    values = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    variance = max(1.0, (squares - float(right @ values)) / max(freedom - 4, 1))
    squared = 1.0 + float(values[3]) / (GRAVITY_M_S2 * physics.length)
    error = float(np.sqrt(variance * np.linalg.pinv(matrix)[3, 3])) / (GRAVITY_M_S2 * physics.length)
    clock = float(np.sqrt(max(squared, 1e-6)))
    return clock, 0.5 * error / clock


def _free_fall(entry: Entry) -> tuple[Array, Array]:
    """Derivatives (3 n, 4) of the heights and places of one flight by a load (3,) and by gravity, and what is left (3 n,)
    of them, all without what a straight line explains."""
    rows, state = entry.outset.rows, entry.outset.fair_state
    times = entry.track.time_s[rows] - state.time_s
    line = np.stack([np.ones_like(times), times], 1)
    rest = np.eye(len(rows)) - line @ np.linalg.pinv(line)
    circled = -np.einsum("mn,nij->mij", rest, matrix_from_quat(entry.track.quaternion[rows])).reshape(-1, 3)
    fall = np.zeros((len(rows), 3))
    fall[:, 2] = -0.5 * (rest @ times**2)
    flown = state.position_m + np.outer(times, state.velocity_m_s)
    flown[:, 2] -= 0.5 * GRAVITY_M_S2 * times**2
    left = rest @ (entry.track.position_m[rows] - flown)
    return np.column_stack([circled, fall.ravel()]), left.ravel()


def _widened(crowd: Crowd, point: Point, effect: str) -> Point:
    """The fit with one effect more, from the best of a few starts."""
    physics = point.physics.with_values(**{name: point.physics.off(name) for name in EFFECTS[effect]})
    starts = _starts(physics, effect, crowd.entries)
    few = crowd.some(FOR_FIRST)
    best = min(starts, key=few.mean_cost) if len(starts) > 1 else starts[0]
    return descended(crowd, best, CONVERGED_ENOUGH)


def _starts(physics: Physics, effect: str, entries: Sequence[Entry]) -> list[Physics]:
    if effect == "friction":
        return [physics.with_values(mu=mu, chi=chi) for mu in _FIRST_MU for chi in FIRST_CHI[:-1]]
    if effect == "rounded corners":
        return [physics.with_values(corner_radius_m=part * physics.die.solid.inradius) for part in _FIRST_RADII]
    if effect == "loaded die":
        return [physics, physics.with_values(**dict(zip(LOAD, load_before_bounces(entries).tolist(), strict=True)))]
    if effect in ("fading restitution", "fading friction"):
        return [physics.with_values(**{EFFECTS[effect][0]: fade}) for fade in _FIRST_FADES_S_PER_M]
    return [physics]


def _price(gains: Array) -> float:
    """What gains (throws,) must have as their mean not to be chance."""
    return float(student.ppf(_SURE, len(gains) - 1) * gains.std(ddof=1) / np.sqrt(len(gains)))


def _evidence(gains: Array) -> float:
    """Units of log-likelihood by which throws left out are foretold better, were the mean gain normally distributed."""
    error = float(gains.std(ddof=1)) / np.sqrt(len(gains))
    return 0.5 * (float(gains.mean()) / max(error, 1e-300)) ** 2 * float(np.sign(gains.mean()))


def _refusal(effect: str, gains: Array, before: Array) -> Effect:
    part, error = gains.mean() / before.mean(), gains.std(ddof=1) / np.sqrt(len(gains)) / before.mean()
    if gains.mean() <= 0.0:
        why = f"It foretells throws left out of the fit worse, by {-100 * part:.2g} % of their error."
    else:
        why = (
            f"It foretells throws left out of the fit better by {100 * part:.2g} % of their error, with a standard error "
            f"of {100 * error:.2g} %: no more than chance."
        )
    return Effect(effect, _evidence(gains), why)
