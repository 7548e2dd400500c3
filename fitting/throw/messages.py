"""Messages of a fit, one sentence or two each: what happened, why, and what the numbers then mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..estimation import ResidualErrors
from ..free import Bounce, FreeFlights
from ..results import Parameter
from .contact_sequences import Vertices, own_sequence
from .extension import at_its_limit, can_go_on, keeps_its_sequence
from .shooting import Trajectory

_NOTABLE_VARIANCE = 1.5
"""Variance of the frames about free flights from which a message states it: sigmas that are a fifth too small."""

_NOTABLE_INFLATION = 1.2
"""Factor on variances from which a message states that sigmas were scaled up: by a tenth."""

_NOTABLE_SHARE = 0.01
"""Share of the variance of chi from which a message states where it comes from."""

_SOURCES = {
    "calibration": "the calibration of the camera",
    "die": "the edge of the die",
    "clock": "the frame rate",
}
"""Sources of errors that all frames share, in words."""

_DEFINITIONS = {
    "stronge": "energies (Stronge)",
    "newton": "normal velocities (Newton)",
    "poisson": "impulses (Poisson)",
    "algebraic": "normal velocities (Chatterjee and Ruina)",
}
"""What each definition of restitution compares before and after an impact."""


def frame_messages(free: FreeFlights) -> list[str]:
    """What the free flights show of the frames, before any impact law is fitted."""
    messages = []
    if free.noise_estimated is not None:
        count, sigma_m, sigma_rad = free.noise_estimated
        consequence = (
            f"their noise was estimated from flights: {1e3 * sigma_m:.3g} mm and {np.rad2deg(sigma_rad):.3g} degrees"
            if np.isfinite(sigma_m)
            else "no flight is long enough to estimate their noise, so they were left out"
        )
        messages.append(f"{count} frames have no usable covariance; {consequence}.")
    if free.outliers:
        messages.append(f"{free.outliers} frames contradict the flight of their neighbours and were left out.")
    if free.variance > _NOTABLE_VARIANCE:
        messages.append(
            f"Within free flights the frames scatter {np.sqrt(free.variance):.2f} times as much as their sigmas state."
        )
    return messages


def shared_error_messages(shares: Mapping[str, Mapping[str, float]], widening: float) -> list[str]:
    """What share of the variance of chi comes from errors that all frames share, and how many times its interval is as wide as if
    there were none."""
    of_chi = shares.get("chi", {})
    notable = [
        (of_chi[source], words) for source, words in _SOURCES.items() if of_chi.get(source, 0.0) >= _NOTABLE_SHARE
    ]
    if not notable:
        return []
    listed = " and ".join(f"{100.0 * share:.0f} % from {words}" for share, words in sorted(notable, reverse=True))
    return [
        f"Of the variance of chi, {listed}. The frames determine these in part, at the cost of their own noise: if they were "
        f"known exactly, the interval would be {widening:.2g} times narrower."
    ]


def bounce_messages(
    trajectories: list[Trajectory], free: FreeFlights, bounces: tuple[int, int], beside: str
) -> list[str]:
    """The `bounces` that the fit explains, of all, and why it stops; `beside` are the frames of the flights on either side of the
    next."""
    messages, best, (explained, total) = [], trajectories[0], bounces
    if explained < total:
        messages.append(
            f"The model explains {explained} of {total} bounces; {_why_no_more(best, free, explained, beside)}."
        )
    if len(best.vertices) != explained:
        messages.append(
            f"The fitted throw has {len(best.vertices)} impacts where {explained} bounces were measured: "
            f"vertices {_listed(best.vertices)}."
        )
    if len(trajectories) > 1:
        others = "; ".join(" ".join(map(str, other.vertices)) for other in trajectories[1:])
        messages.append(f"Other sequences of vertices agree with the frames too: {others}.")
    if not keeps_its_sequence(best):
        simulated = own_sequence(best.physics, best.state, float(best.observations.time_s[-1]))
        messages.append(
            "A simulation from the fitted initial state touches with other vertices than those fitted: "
            f"{_listed(simulated) or 'none'} instead of {_listed(best.vertices)}."
        )
    return messages


def restitution_messages(alternatives: list[Trajectory]) -> list[str]:
    """What the definitions of restitution that agree with the frames make of χ; nothing where one alone does, or all are the
    same."""
    values = {one.physics.restitution: one.physics.values["chi"] for one in reversed(alternatives)}
    if len(values) < 2:
        return []
    mine = alternatives[0].physics.restitution
    others = [f"{chi:.4f} by {_DEFINITIONS[kind]}" for kind, chi in values.items() if kind != mine]
    return [
        f"The frames do not tell how restitution is defined where a slip stops: χ is {values[mine]:.4f} by "
        f"{_DEFINITIONS[mine]}, {' and '.join(others)}; an interval from the profile holds them all."
    ]


def _listed(vertices: Vertices) -> str:
    return ", ".join(map(str, vertices))


def _why_no_more(trajectory: Trajectory, free: FreeFlights, explained: int, beside: str) -> str:
    if not can_go_on(free, trajectory.reached):
        return "the flights that follow have fewer than two frames clear of impacts"
    if at_its_limit(trajectory):
        return (
            "errors of the initial state grow from bounce to bounce, and double precision cannot carry the fit through "
            f"another (rounding alone already moves frames by {trajectory.rounding:.0e} sigma)"
        )
    limit = free.choices.misfit_limit
    return (
        f"after bounce {explained + 1} every trajectory that was tried lies more than {limit:g} times as far from the "
        f"frames as they scatter: none of the laws that were tried describes it, or some poses of {beside} are wrong"
    )


def inflation_messages(errors: ResidualErrors) -> list[str]:
    """By how much sigmas and intervals were scaled up, if they were."""
    if errors.scale < _NOTABLE_INFLATION:
        return []
    shown = [f"correlated over {errors.correlation_time:.1f} frames"]
    if errors.variance > 1.0:
        shown.insert(0, f"{np.sqrt(errors.variance):.2f} sigma (rms)")
    why = ["the frames' errors are larger than stated"] if errors.variance > 1.0 else []
    if errors.misfit > _NOTABLE_INFLATION:
        why.append(f"flights differ {np.sqrt(errors.misfit):.2f} times as much from the law as these errors explain")
    because = f" ({', and '.join(why)})" if why else ""
    return [
        f"Residuals are {' and '.join(shown)}{because}: sigmas and intervals are scaled up by at most "
        f"{np.sqrt(errors.scale):.2f}."
    ]


def unexplained_message(total: int, worst_sigmas: float | None, bounces: Sequence[Bounce | None], beside: str) -> str:
    """Why no trajectory explains the first bounce; `beside` are the frames of the flights on either side of it."""
    how = (
        "no trajectory reaches the next flight"
        if worst_sigmas is None
        else f"the best trajectory misses the frames of one of the two flights by {worst_sigmas:.1f} sigma (rms)"
    )
    message = (
        f"The model explains 0 of {total} bounces; {how}: none of the laws that were tried describes these impacts, some poses "
        f"of {beside} are wrong, or their errors are far larger than stated. The initial state is that of the first flight alone."
    )
    smooth = [bounce.smooth_sigmas for bounce in bounces if bounce is not None and np.isfinite(bounce.smooth_sigmas)]
    if smooth:
        message += (
            f" The impulses of single bounces differ from those of a smooth impact by up to {max(smooth):.1f} sigma."
        )
    return message


def ratio_message(common: tuple[float, float, float] | None, chi: Parameter | None, count: int) -> str:
    """What is known of χ from the ratios of normal velocities at `count` bounces, where no law explains them."""
    if common is None:
        return "chi cannot be determined: no bounce lies between two flights that determine its normal velocities."
    if chi is None or chi.value is None:
        return "chi cannot be determined: the ratios of normal velocities at the bounces contradict each other."
    return (
        f"chi is the ratio of normal velocities at {count} bounce{'s' if count > 1 else ''}, which needs no impact law; "
        "its interval includes their scatter."
    )
