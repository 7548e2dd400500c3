"""The values of a fit: parameters with intervals, initial conditions with covariance, and messages.

What the data do not determine is None, with a message in `Fit.messages` that says why; no number is made up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError
from ..model.laws import Restitution
from ..model.throw import State, Throw

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One parameter of the model and its interval."""

    value: float | None
    """In the unit of the parameter's name; None if the data do not determine it."""
    low: float | None
    high: float | None
    """Bounds of the interval; None if it cannot be had."""
    level: float | None
    """Coverage of the interval, such as 0.95; None without an interval."""
    free: bool
    """True if the data moved it, False if it was held."""
    at_bound: bool
    """True if the best value lies on a bound of what the law allows; the interval is then one-sided."""


@dataclass(frozen=True, eq=False)
class ParameterCovariance:
    """The joint covariance of the free parameters of a fit."""

    names: tuple[str, ...]
    matrix: Array
    """(k, k), units of the parameters."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a law misses: how far throws that were left out of a fit are off, beyond the errors of their release states."""

    time_s: Array
    """(m,) since the release state, ascending."""
    position_m: Array
    """(m,) root mean square of one axis."""
    rotation_rad: Array
    """(m,) the same."""

    def covariances(self, since_s: Array) -> Array:
        """(n, 6, 6) of position and rotation vector at times (n,) [s] since the release state; constant beyond the table."""
        variances = np.empty((len(since_s), 6))
        variances[:, :3] = np.interp(since_s, self.time_s, self.position_m**2)[:, None]
        variances[:, 3:] = np.interp(since_s, self.time_s, self.rotation_rad**2)[:, None]
        return np.asarray(variances[:, :, None] * np.eye(6))


@dataclass(frozen=True)
class Effect:
    """A departure from the plainest model, and the evidence for it."""

    name: str
    evidence: float | None
    """Units of log-likelihood by which the effect improves the fit; None if it was not tried."""
    why_not: str | None
    """Why it was refused, as a sentence; None for an effect that was accepted."""


IntervalMethod = Literal["profile", "covariance", "bootstrap"]
INTERVAL_METHODS: tuple[IntervalMethod, ...] = ("profile", "covariance", "bootstrap")
"""Where the profile of the cost rises by z²; ±1.96 σ, cut at what the law allows; percentiles of fits to residuals redrawn
in blocks. The first needs neither a quadratic cost nor a normal distribution and takes 2 to 3 times as long as the second;
the third takes far longer."""

MISFIT_LIMITS = 1.5, 4.0
"""Least and largest misfit limit: below, no other explanation of a flight is looked for; beyond, descents are given up."""

MOST_FRICTION = 3.0
"""Largest coefficient of friction of a fit."""


@dataclass(frozen=True)
class Choices:
    """What a fit assumes or decides beside what the frames show; in `fit.json`, with a switch of `diethrow fit` for each."""

    intervals: IntervalMethod = "profile"
    """Where the intervals come from."""
    misfit_limit: float = 2.5
    """Largest ratio of the residuals of a trajectory to those of free flights at which it still explains the frames. Smaller
    stops the fit at a bounce that the law describes nearly; larger may take wrong corners for such bounces."""
    usual_friction: float | None = 0.3
    """Friction coefficient of usual scenes. Where the frames allow any larger one, the fitted value nearest to it is reported;
    None: that of the least cost, though others cost as much."""
    effects: tuple[str, ...] | None = None
    """Effects on trial; None: all that the model has of the die."""

    def __post_init__(self) -> None:
        low, high = MISFIT_LIMITS
        if not low <= self.misfit_limit <= high:
            raise InputError(f"misfit_limit = {self.misfit_limit}: wanted a ratio from {low:g} to {high:g}")
        if self.usual_friction is not None and not 0.0 < self.usual_friction <= MOST_FRICTION:
            raise InputError(
                f"usual_friction = {self.usual_friction}: wanted a coefficient above 0, up to {MOST_FRICTION:g}, or None"
            )


USUAL_CHOICES = Choices()
"""What is not said otherwise."""


STATE_NAMES = (
    *("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"),
    *("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s"),
)
"""Components of the error of an initial state: position, rotation vector, velocity, angular velocity, world axes."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The model that a track supports."""

    parameters: dict[str, Parameter]
    """By name; always with `chi`."""
    initial: State | None
    """The fitted state at the beginning of the first flight: on the true clock and in true metres if the fit found that
    those of the track differ (`clock_scale`, `length_scale`)."""
    initial_covariance: Array | None
    """(12, 12) of `initial`: position [m], rotation vector [rad], velocity [m/s], angular velocity [rad/s], world axes,
    R_true = exp(δ) R; scaled up by what the residuals show of the frames' true errors."""
    chosen: tuple[str, ...]
    """Names of the effects in the model."""
    considered: tuple[Effect, ...]
    """The effects that were refused."""
    bounces_fitted: int
    """Bounces of the measured throw that the model explains."""
    residual_rms: float | None
    """Root mean square of the whitened residuals: 1 if the model and the frames' covariances are right. If no bounce is
    explained: of the model's best attempt at the first bounce."""
    landed_face: int | None
    """Number (1, 2, …) of the face that the die comes to rest on; None if this is not decided."""
    face_odds: dict[int, float] | None
    """Share of landings on each face when throws drawn from the fit are simulated to rest; None if not computed."""
    messages: tuple[str, ...]
    """Sentences that a reader of the numbers should know."""
    throw: Throw | None
    """The model's throw, from `initial` through every fitted impact, on the track's clock and in its metres."""
    restitution: Restitution = "stronge"
    """What χ means in frictional contact; see `model.laws.CoulombImpact`."""
    covariance: Array | None = None
    """(12 + k, 12 + k) of `initial` and of the k free parameters in the order of `parameters`; None if no such fit was
    made."""
    variance_shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Shares of the variance of each parameter, which add up to 1: `noise` of the frames, `calibration`, `die`, `clock`, and
    `impact law`, what the residuals show beyond all of these. Empty where cameras, die and clock are exact."""
    choices: Choices = USUAL_CHOICES
    """What it was made with."""
    vertices: tuple[int, ...] = ()
    """Indices of the vertices that strike at the fitted bounces."""
    fitted_until_s: float | None = None
    """Time of the last frame in the fit, on the clock of `initial`."""

    @property
    def covariance_names(self) -> tuple[str, ...]:
        """Of the rows of `covariance`."""
        return (*STATE_NAMES, *(name for name, parameter in self.parameters.items() if parameter.free))
