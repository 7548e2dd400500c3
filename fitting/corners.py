"""Rounded corners without friction, as a sharp die that flies a little lower.

A polyhedron whose corners and edges are rounded with radius r is the sum, point by point, of a ball of radius r and the
same polyhedron shrunk by 1 - r/ρ (ρ the inscribed radius). It meets the table when the shrunk one comes within r of it,
right below the shrunk corner; and since a vertical impulse does not care how far below, a smooth impact of the rounded
die is that of the shrunk sharp die whose centre is r lower. Mass, inertia, spins and instants stay. So a fit to rounded
dice is a fit to sharp ones, between these two changes of variables.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.motion import GRAVITY_M_S2, State, Throw
from ..model.solids import Die
from ..tracking.track import Track


def sharp_equivalent(die: Die) -> Die:
    """The shrunk sharp die that bounces like the rounded one; the die itself where it is sharp."""
    if die.corner_radius_m == 0.0:
        return die
    shrink = 1.0 - die.corner_radius_m / die.solid.inradius
    solid = replace(die.solid, vertices=die.solid.vertices * shrink, offsets=die.solid.offsets * shrink)
    return replace(die, solid=solid, corner_radius_m=0.0)


def raised_state(state: State, height_m: float) -> State:
    """The state, lifted."""
    return replace(state, position_m=state.position_m + np.array([0.0, 0.0, height_m]))


def raised_track(track: Track, height_m: float) -> Track:
    """The track, lifted."""
    return replace(track, position_m=track.position_m + np.array([0.0, 0.0, height_m]))


def raised_throw(die: Die, throw: Throw, height_m: float) -> Throw:
    """The throw, lifted: flights by height, impacts by potential energy."""
    energy_J = die.mass_kg * GRAVITY_M_S2 * height_m
    flights = tuple(replace(flight, start=raised_state(flight.start, height_m)) for flight in throw.flights)
    impacts = tuple(
        replace(
            impact,
            energy_before_J=impact.energy_before_J + energy_J,
            energy_after_J=impact.energy_after_J + energy_J,
        )
        for impact in throw.impacts
    )
    return Throw(flights, impacts)
