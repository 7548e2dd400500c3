"""Clock and length scales of a track: conversion from the track's units to true ones, and back.

A second of the track is `clock_scale` true seconds; a true metre is `length_scale` metres of the track. The model is on
the true clock and in true metres. What is drawn beside the track, or compared with it, is converted back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.throw import Flight, Impact, State, Throw
from .physics import Physics

Array = NDArray[np.float64]


def in_true_units(physics: Physics, state: State) -> State:
    """A state on the track's clock and in its metres, converted by the scales of the physics."""
    clock, length = physics.clock, physics.length
    return State(
        clock * state.time_s,
        state.position_m / length,
        state.quaternion,
        state.velocity_m_s / (clock * length),
        state.omega_rad_s / clock,
    )


def as_tracked(physics: Physics, throw: Throw) -> Throw:
    """The throw on the track's clock and in its metres; unchanged where no scale is fitted."""
    clock, length = physics.clock, physics.length
    if clock == 1.0 and length == 1.0:
        return throw
    flights = tuple(_scaled(flight, clock, length) for flight in throw.flights)
    return Throw(flights, tuple(_scaled_impact(impact, clock, length) for impact in throw.impacts))


@dataclass(frozen=True, eq=False, kw_only=True)
class ScaledFlight(Flight):
    """A flight on another clock and in other metres, where gravity differs too."""

    true: Flight
    clock: float
    length: float

    def at(self, time_s: float) -> State:
        """The state at any instant."""
        return _tracked_state(self.true.at(self.clock * time_s), self.clock, self.length)

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        positions, quaternions = self.true.poses(self.clock * np.asarray(times_s, float))
        return self.length * positions, quaternions


def _scaled(flight: Flight, clock: float, length: float) -> ScaledFlight:
    start = _tracked_state(flight.start, clock, length)
    gravity_m_s2 = clock**2 * length * flight.gravity_m_s2
    return ScaledFlight(
        start=start, end_s=flight.end_s / clock, gravity_m_s2=gravity_m_s2, true=flight, clock=clock, length=length
    )


def _tracked_state(state: State, clock: float, length: float) -> State:
    return State(
        state.time_s / clock,
        length * state.position_m,
        state.quaternion,
        clock * length * state.velocity_m_s,
        clock * state.omega_rad_s,
    )


def _scaled_impact(impact: Impact, clock: float, length: float) -> Impact:
    """Impulses and energies stay as they are: those of the model, in true units."""
    return replace(
        impact,
        time_s=impact.time_s / clock,
        point_m=length * impact.point_m,
        normal_velocity_before_m_s=clock * length * impact.normal_velocity_before_m_s,
        normal_velocity_after_m_s=clock * length * impact.normal_velocity_after_m_s,
    )
