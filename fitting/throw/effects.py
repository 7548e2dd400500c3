"""The effects that a throw shows, added one at a time if the evidence supports them.

The fit begins with the plainest model. Every effect that is not in use is then tried on the frames at hand: those of the
bounces explained so far and, where the model stops, of the flight that it cannot explain. Its gain is the fall of half
the cost in a fit with its parameters free, in units of what remains unexplained with the effect: the long-run variance of
the residuals times the misfit of the law (`residual_errors`). An effect is accepted if

- its gain exceeds the penalty k (½ log n + log q), with k its parameters, n the residuals and q the effects on trial. This
  is half the extended Bayesian information criterion (Chen & Chen, Biometrika 95, 759, 2008), whose second term
  corrects for the choice among many; one effect in two hundred is then accepted by chance; and
- it predicts better: blocks of neighbouring frames that are left out are predicted more closely with it than without; and
- it is larger than what the calibration of a camera leaves open in any scene (`physics.CALIBRATION_LIMITS`).

The accepted effect that leads through most bounces is taken, the bounces are fitted again, and the other effects are tried
anew. The gain is first estimated from derivatives at the present fit (Rao's score test); only effects with a chance of
being accepted are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.throw import Throw
from ..estimation import compressed, huber, orthonormal_basis, times_inverse
from ..free import FreeFlights, MassOffset, mass_offset_from_flights, table_motion_candidates
from ..results import Effect
from .extension import best_attempt, extend, friction_alternatives, is_explained, starts_with, well_explained
from .physics import EFFECTS, Physics
from .shooting import Trajectory, fit_trajectory, linearised, linearised_with, refitted, refitted_with, with_physics

Array = NDArray[np.float64]

_BLOCK_FRAMES = 6
"""Frames that are left out together, because errors of neighbours are correlated."""

_MIN_EIGENVALUE = 1e-3
"""Smallest eigenvalue of 1 - H_bb at which the other frames can still predict a block."""

_SCREENING_SHARE = 0.3
"""Share of the penalty from which an effect is fitted: a gain estimated from derivatives may fall short of the real one."""

_MIN_CONSISTENCY = 0.5
"""Least `MassOffset.consistency` at which a loaded die is fitted."""

HELD_AT_FIRST = frozenset({"table_frequency_hz", "table_phase_rad"})
"""Parameters of a table's motion that a fit to the first bounces holds: one bounce cannot determine three numbers."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One effect tried on the frames of a trajectory."""

    effect: str
    trajectory: Trajectory | None
    """With the effect; None where derivatives already show too little gain."""
    gain: float
    """Units of log-likelihood."""
    penalty: float
    """What the gain must exceed."""
    predictive_gain: float
    """Units of log-likelihood by which frames that are left out are predicted better; 0 where the effect was not fitted."""
    unexplained: float = 1.0
    """s² τ of the residuals with the effect: the unit of the gain in half the cost."""

    @property
    def is_accepted(self) -> bool:
        """Whether the effect is added to the model."""
        if self.trajectory is None or self.gain <= self.penalty or self.predictive_gain <= 0.0:
            return False
        return self.trajectory.physics.exceeds_calibration(self.effect)

    def net_gain(self, unexplained: float) -> float:
        """Gain beyond the penalty, in units of what another effect leaves unexplained. Effects are compared in one unit: of two
        that explain a bounce equally well, whose gains are thousands, chance decides which leaves residuals a few per cent
        smaller or less correlated."""
        return self.gain * self.unexplained / unexplained - self.penalty

    @property
    def as_effect(self) -> Effect:
        """As an entry of the result."""
        if self.is_accepted:
            return Effect(self.effect, self.gain, None)
        names = EFFECTS[self.effect]
        gains = f"It gains {self.gain:.1f} units of log-likelihood"
        if self.gain <= self.penalty:
            count = "one parameter" if len(names) == 1 else f"{len(names)} parameters"
            why = f"{gains}; for {count} more than {self.penalty:.1f} are required."
        elif self.predictive_gain <= 0.0:
            why = f"{gains} on the frames it is fitted to, but predicts frames left out of the fit no better."
        else:
            assert self.trajectory is not None
            found = ", ".join(f"{name} {self.trajectory.physics.values[name]:.6g}" for name in names)
            why = f"{gains}, but its size ({found}) is within what the camera's calibration leaves open."
        return Effect(self.effect, self.gain, why)


def try_effects(trajectory: Trajectory, measured: Throw, free: FreeFlights) -> list[Trial]:
    """Every effect that is not in use, tried on the frames that a trajectory explains."""
    return [_try(trajectory, effect, measured, free) for effect in unused_effects(trajectory.physics, free)]


def try_effects_on_next_flight(trajectory: Trajectory, measured: Throw, free: FreeFlights) -> list[Trial]:
    """Every effect that is not in use, tried on the flight after the last that a trajectory explains.

    The trajectory's own fit to those frames is too far off for derivatives to be of use, or for a descent to lead back
    from it. Each effect therefore starts from where the trajectory still fitted, at several strengths.
    """
    attempt = best_attempt(trajectory, measured, free)
    if attempt is None or not attempt.vertices:
        return try_effects(trajectory, measured, free) if trajectory.vertices else []
    trials: list[Trial] = []
    for effect in unused_effects(trajectory.physics, free):
        # Once one effect explains the flight, another must do the same, which a few frames show.
        explained = any(trial.trajectory is not None and is_explained(trial.trajectory, free) for trial in trials)
        trials.append(_try_on_attempt(trajectory, attempt, effect, measured, free, exhaustive=not explained))
    return trials


def superseded_effect(trajectory: Trajectory, free: FreeFlights) -> str | None:
    """An effect in use that the trajectory no longer needs to explain its frames; None if all are needed.

    The effect that was added first may have stood for one that was added later.
    """
    k2 = free.huber_threshold
    for effect in trajectory.physics.effects:
        plainer = refitted_with(trajectory, trajectory.physics.without_effect(effect), k2)
        if not _compared(plainer, trajectory, effect, free).is_accepted:
            return effect
    return None


def unused_effects(physics: Physics, free: FreeFlights) -> list[str]:
    """The effects on trial that are not in use and are compatible with those that are."""
    on_trial = EFFECTS if free.choices.effects is None else free.choices.effects
    return [effect for effect in on_trial if physics.is_compatible_with(effect) and effect not in physics.effects]


def _try(trajectory: Trajectory, effect: str, measured: Throw, free: FreeFlights) -> Trial:
    """One effect on the frames that a trajectory explains."""
    k2 = free.huber_threshold
    if effect == "loaded die":
        return _try_mass_offset(trajectory, free)
    if _is_unknown_motion(effect, trajectory.physics):
        return _try_motion(trajectory, measured, free)
    wider, residuals, jacobian = linearised_with(trajectory, trajectory.physics.with_effect(effect), k2)
    estimate = _linearised_gain(residuals, jacobian, wider.root)
    if estimate < _SCREENING_SHARE * _penalty(trajectory, effect, free):
        return Trial(effect, None, estimate, _penalty(trajectory, effect, free), 0.0)
    return _compared(trajectory, refitted(wider, k2), effect, free)


def _try_mass_offset(trajectory: Trajectory, free: FreeFlights) -> Trial:
    """The same for a loaded die. Free flights estimate its gain, so that scenes with a fair die need no simulation of an
    asymmetric body."""
    effect, k2 = "loaded die", free.huber_threshold
    offset, gain = _promising_offset(trajectory, free)
    if offset is None:
        return Trial(effect, None, gain, _penalty(trajectory, effect, free), 0.0)
    # Also from zero: the initial state that fits without the offset may lie far from the one that fits with it.
    starts = (trajectory.physics.with_values(**offset.values), trajectory.physics.with_effect(effect))
    found = [refitted_with(trajectory, start, k2) for start in starts]
    return _compared(trajectory, min(found, key=lambda other: other.cost(k2)), effect, free)


def _try_motion(trajectory: Trajectory, measured: Throw, free: FreeFlights) -> Trial:
    """The same for a table that oscillates, from the motions that the bounces show."""
    effect, k2 = "oscillating table", free.huber_threshold
    motions = table_motion_candidates(trajectory.physics.body, free, measured.impacts)
    found = [refitted_with(trajectory, trajectory.physics.with_values(**motion), k2) for motion in motions]
    if not found:
        return Trial(effect, None, 0.0, _penalty(trajectory, effect, free), 0.0)
    return _compared(trajectory, min(found, key=lambda other: other.cost(k2)), effect, free)


def _try_on_attempt(
    trajectory: Trajectory, attempt: Trajectory, effect: str, measured: Throw, free: FreeFlights, *, exhaustive: bool
) -> Trial:
    """One effect on the frames of an attempt that failed without it."""
    k2, physics = free.huber_threshold, trajectory.physics
    starts = [*starts_with(effect, physics, free, trajectory.reached, attempt.reached), physics.with_effect(effect)]
    if effect == "loaded die":
        offset, gain = _promising_offset(attempt, free)
        if offset is None:
            return Trial(effect, None, gain, _penalty(attempt, effect, free), 0.0)
        starts = [physics.with_values(**offset.values)]
    if _is_unknown_motion(effect, physics):
        motions = table_motion_candidates(physics.body, free, measured.impacts)
        starts = [replace(physics.with_values(**motion), held=HELD_AT_FIRST) for motion in motions]
        exhaustive = True  # few scenes have it, and there another effect may have passed for it at the first bounce
    onward = attempt.vertices[len(trajectory.vertices) :]
    found: list[Trajectory] = []
    starts += [redefined for start in starts for redefined in start.with_other_restitutions()]
    for start in starts:
        other = extend(with_physics(trajectory, start, k2), onward, attempt.reached, free, exhaustive=exhaustive)
        found += [] if other is None else [other]
        if other is not None and well_explained(other, free):
            break
    if not found:
        return Trial(effect, None, 0.0, _penalty(attempt, effect, free), 0.0)
    best = min(found, key=lambda other: other.mean_square)
    fitted = fit_trajectory(attempt.observations, best, best.vertices, k2)
    return _compared(attempt, friction_alternatives(fitted, free)[0], effect, free)


def _is_unknown_motion(effect: str, physics: Physics) -> bool:
    """Whether an effect is the motion of a table of which the scene states nothing: no derivative leads there from rest."""
    return effect == "oscillating table" and not physics.table.moves


def _promising_offset(trajectory: Trajectory, free: FreeFlights) -> tuple[MassOffset | None, float]:
    """The centre-of-mass offset that the flights show, None if it is not worth a fit, and its gain there.

    An offset that differs from flight to flight is none: a single flight that was tracked wrongly gains much by it.
    """
    offset = mass_offset_from_flights(free)
    gain = 0.0 if offset is None or offset.consistency < _MIN_CONSISTENCY else offset.gain
    return (offset if gain >= _SCREENING_SHARE * _penalty(trajectory, "loaded die", free) else None), gain


def _compared(trajectory: Trajectory, wider: Trajectory, effect: str, free: FreeFlights) -> Trial:
    """What an effect gains on the frames that both trajectories are fitted to."""
    scale, k2 = wider.errors.scale, free.huber_threshold
    gain = 0.5 * (trajectory.cost(k2) - wider.cost(k2)) / scale
    # nansum: blocks without which either fit is undetermined do not enter the comparison.
    predicted = 0.5 * float(np.nansum(left_out_costs(trajectory, k2) - left_out_costs(wider, k2))) / scale
    return Trial(effect, wider, gain, _penalty(trajectory, effect, free), predicted, scale)


def _penalty(trajectory: Trajectory, effect: str, free: FreeFlights) -> float:
    """What an effect must gain on the frames of a trajectory."""
    count = max(len(unused_effects(trajectory.physics, free)), 1)
    return len(EFFECTS[effect]) * float(0.5 * np.log(trajectory.residuals.size) + np.log(count))


def _linearised_gain(residuals: Array, jacobian: Array, root: Array) -> float:
    """Fall of half the cost if the residuals were linear in all unknowns, in units of what is left."""
    rows = compressed(residuals.ravel(), times_inverse(jacobian.reshape(-1, jacobian.shape[2]), root))
    left = float(rows[-1, -1] ** 2)
    fall = float((residuals**2).sum()) - left
    return 0.5 * fall / max(1.0, left / max(residuals.size - len(root), 1))


def left_out_costs(trajectory: Trajectory, k2: float) -> Array:
    """ρ summed over each block of frames, predicted by a fit without them; NaN for a block that alone fixes a direction.

    With H the hat matrix of a linear fit, the residuals of a block left out are (1 - H_bb)⁻¹ r_b (Cook & Weisberg,
    Residuals and Influence in Regression, 1982, Sec. 3.2).
    """
    found = linearised(trajectory, k2)
    residuals, jacobian = found.of_frames, found.by_frames
    q = orthonormal_basis(jacobian.reshape(-1, jacobian.shape[2]), trajectory.root).reshape(len(residuals), 6, -1)
    costs = []
    for rows in _blocks(trajectory):
        own = q[rows].reshape(-1, q.shape[2])
        complement = np.eye(len(own)) - own @ own.T
        if np.linalg.eigvalsh(complement)[0] < _MIN_EIGENVALUE:
            costs.append(np.nan)
            continue
        left_out = np.linalg.solve(complement, residuals[rows].ravel()).reshape(-1, 6).astype(np.float64)
        scaled, _ = huber(left_out, np.empty((len(left_out), 6, 0)), k2)
        costs.append(float((scaled**2).sum()))
    return np.array(costs)


def _blocks(trajectory: Trajectory) -> list[NDArray[np.int64]]:
    """Rows of neighbouring frames of one flight, `_BLOCK_FRAMES` or so at a time."""
    blocks: list[NDArray[np.int64]] = []
    for k in np.unique(trajectory.observations.flight):
        rows = np.flatnonzero(trajectory.observations.flight == k)
        blocks.extend(np.array_split(rows, max(1, round(len(rows) / _BLOCK_FRAMES))))
    return blocks
