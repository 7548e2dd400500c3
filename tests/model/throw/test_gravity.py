"""Another gravity: under k g a die moves as under g, with velocities larger by the root of k."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model.die import Die
from diethrow.model.die.die import loaded_die
from diethrow.model.laws import CoulombImpact, ImpactLaw, SmoothImpact, Table
from diethrow.model.rotations import rotation_between
from diethrow.model.throw import State, Throw, Until, energy_J, propagate, throw_die
from diethrow.model.world import GRAVITY_M_S2

CUBE = DICE["cube"]
LOADED = loaded_die(CUBE.solid, CUBE.mass_kg, 0.1 * CUBE.mass_kg, [0.002, 0.001, -0.001])
WORLDS = {
    "smooth": (DICE["icosahedron"], SmoothImpact(0.6), Table()),
    "friction": (DICE["cube"], CoulombImpact(0.5, 0.3), Table()),
    "tilted": (DICE["octahedron"], CoulombImpact(0.5, 0.3), Table(tilt_rad=0.1, downhill_rad=0.4)),
    "oscillating": (DICE["cube"], SmoothImpact(0.6), Table(amplitude_m=1e-3, frequency_hz=25.0, phase_rad=0.4)),
    "loaded": (LOADED, SmoothImpact(0.6), Table()),
}
World = tuple[Die, ImpactLaw, Table]


def on(table: Table, k: float) -> Table:
    """The table where gravity is k times as strong, at the faster motion."""
    return replace(table, gravity_m_s2=k * table.gravity_m_s2, frequency_hz=np.sqrt(k) * table.frequency_hz)


def faster(state: State, k: float) -> State:
    root = np.sqrt(k)
    return replace(
        state,
        time_s=state.time_s / root,
        velocity_m_s=root * state.velocity_m_s,
        omega_rad_s=root * state.omega_rad_s,
    )


def assert_same_path(one: Throw, other: Throw, times_s: np.ndarray, k: float, atol: float = 1e-9) -> None:
    """Poses of `one` at these times are those of `other`, which is faster."""
    positions, quaternions = one.poses(times_s)
    positions_k, quaternions_k = other.poses(times_s / np.sqrt(k))
    np.testing.assert_allclose(positions_k, positions, atol=atol)
    np.testing.assert_allclose(rotation_between(quaternions, quaternions_k), 0.0, atol=100.0 * atol)
    np.testing.assert_allclose(other.rates(times_s / np.sqrt(k)), np.sqrt(k) * one.rates(times_s), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("k", [0.165, 4.0])
@pytest.mark.parametrize("world", WORLDS)
def test_a_throw_takes_the_same_path(world: str, k: float) -> None:
    die, law, table = WORLDS[world]
    release = random_release(np.random.default_rng(3), die)
    throws = [
        throw_die(die, start, law, until=Until(impacts=4), table=there).throw
        for start, there in ((release, table), (faster(release, k), on(table, k)))
    ]
    times = np.linspace(release.time_s, throws[0].flights[-1].end_s, 50)[1:-1]
    assert_same_path(*throws, times, k)
    for one, other in zip(throws[0].impacts, throws[1].impacts, strict=True):
        assert other.vertices == one.vertices
        assert other.energy_before_J == pytest.approx(k * one.energy_before_J)
        assert other.energy_after_J == pytest.approx(k * one.energy_after_J)


@pytest.mark.parametrize("world", WORLDS)
def test_energy_is_kept_in_flight(world: str) -> None:
    die, law, table = WORLDS[world]
    slow = replace(table, gravity_m_s2=1.62)
    throw = throw_die(die, random_release(np.random.default_rng(4), die), law, until=Until(impacts=2), table=slow).throw
    for flight in throw.flights[:2]:
        states = [flight.at(t) for t in np.linspace(flight.start.time_s, flight.end_s, 5)[:-1]]
        energies = [energy_J(die, state, flight.gravity_m_s2) for state in states]
        np.testing.assert_allclose(energies, energies[0], rtol=1e-9)


@pytest.mark.parametrize("drag_per_m", [0.0, 0.5])
def test_derivatives_and_drag_follow(drag_per_m: float) -> None:
    """By the start in units of the faster motion; drag, in 1/m, stays the same."""
    die, k = DICE["cube"], 0.165
    release = random_release(np.random.default_rng(5), die)
    vertices = [i.vertices[0] for i in throw_die(die, release, SmoothImpact(0.6), until=Until(impacts=2)).throw.impacts]
    times = release.time_s + np.linspace(0.0, 0.2, 20)
    one, other = (
        propagate(die, start, 0.6, t, vertices=vertices, table=table, drag_per_m=drag_per_m)
        for start, t, table in (
            (release, times, Table()),
            (faster(release, k), times / np.sqrt(k), Table(gravity_m_s2=k * GRAVITY_M_S2)),
        )
    )
    # The air is integrated in steps of a fixed time.
    assert_same_path(one.throw, other.throw, times, k, atol=1e-9 if drag_per_m == 0.0 else 1e-8)
    unit = np.repeat([1.0, 1.0, np.sqrt(k), np.sqrt(k), 1.0], [3, 3, 3, 3, 1])
    np.testing.assert_allclose(other.jacobian * unit, one.jacobian, rtol=1e-5, atol=1e-6 * np.abs(one.jacobian).max())


def test_no_gravity_is_refused() -> None:
    for value in (0.0, -9.81, np.nan):
        with pytest.raises(ValueError, match="gravity_m_s2"):
            Table(gravity_m_s2=value)
