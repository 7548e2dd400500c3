"""What a fit says of itself, one sentence each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..free import Bounce, FreeFlights
from .contact_sequences import own_sequence
from .extension import MISFIT, at_its_limit, can_go_on, keeps_its_sequence
from .shooting import Shot


def frame_words(free: FreeFlights) -> list[str]:
    """What to say of the frames before any law of impact is tried."""
    words = []
    if free.noise_estimated is not None:
        count, sigma_m, sigma_rad = free.noise_estimated
        told = (
            f"their noise was estimated from flights: {1e3 * sigma_m:.3g} mm and {np.rad2deg(sigma_rad):.3g} degrees"
            if np.isfinite(sigma_m)
            else "no flight is long enough to estimate their noise, so they were left out"
        )
        words.append(f"{count} frames have no usable covariance; {told}.")
    if free.outliers:
        words.append(f"{free.outliers} frames contradict the flight that their neighbours make, and were left out.")
    if free.variance > 1.5:
        words.append(
            f"Within free flights the frames scatter {np.sqrt(free.variance):.2f} times as much as they state."
        )
    return words


def bounce_words(shots: list[Shot], free: FreeFlights, total: int, explained: int) -> list[str]:
    """What to say of the bounces that the fit runs through, and of the one that stopped it."""
    words, shot = [], shots[0]
    if explained < total:
        words.append(f"The model explains {explained} of {total} bounces; {_why_no_more(shot, free, explained)}.")
    if len(shot.vertices) != explained:
        words.append(
            f"The fitted throw has {len(shot.vertices)} impacts where {explained} bounces were measured: "
            f"vertices {', '.join(map(str, shot.vertices))}."
        )
    if len(shots) > 1:
        rivals = "; ".join(" ".join(map(str, s.vertices)) for s in shots[1:])
        words.append(f"Other sequences of vertices agree with the frames too: {rivals}.")
    if not keeps_its_sequence(shot):
        by_itself = own_sequence(shot.physics, shot.state, float(shot.sightings.time_s[-1]))
        words.append(
            "Left to itself the fitted throw touches with other vertices than those fitted: "
            f"{', '.join(map(str, by_itself)) or 'none'} instead of {', '.join(map(str, shot.vertices))}."
        )
    return words


def _why_no_more(shot: Shot, free: FreeFlights, explained: int) -> str:
    if not can_go_on(free, shot.reached):
        return "the flights that follow have fewer than two frames clear of impacts"
    if at_its_limit(shot):
        return (
            "errors of the start grow from bounce to bounce, and doubles cannot carry the fit through another "
            f"(rounding alone already moves frames by {shot.rounding:.0e} sigma)"
        )
    return (
        f"after bounce {explained + 1} every throw that was tried misses the frames by more than {MISFIT:g} times "
        "their scatter"
    )


def inflation_words(variance: float, tau: float) -> list[str]:
    """The sentence that says by how much sigmas and intervals were scaled up, if they were."""
    if variance < 1.2 and tau < 1.2:
        return []
    larger = f"{np.sqrt(variance):.2f} sigma (rms) and " if variance > 1.0 else ""
    why = "the frames' errors are larger than stated, or the model is not quite right; " if variance > 1.0 else ""
    return [
        f"Residuals are {larger}alike over {tau:.1f} frames: {why}sigmas and intervals are scaled up by "
        f"{np.sqrt(variance * tau):.2f}."
    ]


def missed_words(total: int, worst_sigmas: float | None, bounces: Sequence[Bounce | None]) -> str:
    """Why no throw runs through the first bounce."""
    missed = (
        "no throw reaches the next flight"
        if worst_sigmas is None
        else f"the best throw misses the frames of one of the two flights by {worst_sigmas:.1f} sigma (rms)"
    )
    words = (
        f"The model explains 0 of {total} bounces; {missed}: no law that was tried describes these impacts, or the "
        "frames' errors are far larger than they state. The start is that of the first flight alone."
    )
    sideways = [b.smooth_sigmas for b in bounces if b is not None and np.isfinite(b.smooth_sigmas)]
    if sideways:
        words += f" Bounce by bounce the impulses miss those of a smooth impact by up to {max(sideways):.1f} sigma."
    return words
