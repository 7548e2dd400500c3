"""The model: numbers of impacts, χ = 0 and χ = 1, and releases at rest."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model.die import die_from_solid, named_solid
from diethrow.model.engine.asymmetric import TorqueFree
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.ensembles.stepping import stepped_landings
from diethrow.model.laws import CoulombImpact, SmoothImpact
from diethrow.model.rotations import matrix_from_quat
from diethrow.model.throw.motion import State, energy_J, turning_of, turns_in_flight
from diethrow.model.throw.simulate import Ending, Until, throw_die

Note = Callable[[str], None]

CUBE = DICE["cube"]


@pytest.mark.parametrize("impacts", [1, 60, 2000], ids=lambda n: f"{n} impact" + "s" * (n > 1))
def test_an_elastic_throw_keeps_its_energy_however_often_it_strikes(impacts: int, happened: Note) -> None:
    """At χ = 1 without friction the energy is constant to rounding over any number of impacts."""
    release = random_release(np.random.default_rng(1), CUBE)
    throw = throw_die(CUBE, release, SmoothImpact(1.0), until=Until(impacts=impacts)).throw
    energies = np.array([energy_J(CUBE, flight.start) for flight in throw.flights])
    drift = float(np.abs(energies / energies[0] - 1.0).max())
    assert len(throw.impacts) == impacts
    # Each impact rounds some ten numbers, up or down.
    assert drift < 1e-15 * 100.0 * max(impacts, 10) ** 0.5
    happened(f"{len(throw.impacts)} made, energy changed by {drift:.0e} of itself")


@pytest.mark.parametrize("chi", [0.0, 1e-9, 0.99], ids=lambda chi: f"chi {chi:g}")
@pytest.mark.parametrize("shape", ["tetrahedron", "icosahedron"])
def test_every_throw_that_loses_energy_comes_to_rest(shape: str, chi: float, happened: Note) -> None:
    """From χ = 0 to χ = 0.99, a die comes to rest on a face."""
    die = DICE[shape]
    results = [throw_die(die, random_release(np.random.default_rng(k), die), SmoothImpact(chi)) for k in range(5)]
    assert all(result.ending is Ending.RESTED for result in results)
    counts = [result.impact_count for result in results]
    happened(f"5 of 5 at rest after {min(counts)} to {max(counts)} impacts")


@pytest.mark.parametrize("mu", [0.0, 1e6], ids=lambda mu: f"mu {mu:g}")
def test_friction_from_none_to_boundless_makes_no_energy(mu: float, happened: Note) -> None:
    """Without friction and with very large friction, no impact adds energy."""
    release = random_release(np.random.default_rng(3), CUBE)
    impacts = throw_die(CUBE, release, CoulombImpact(0.5, mu)).throw.impacts
    gained = max(impact.energy_after_J / impact.energy_before_J - 1.0 for impact in impacts)
    assert gained < 1e-12
    happened(f"{len(impacts)} impacts, the largest gain {max(gained, 0.0):.0e} of the energy")


def test_a_die_that_lies_on_the_table_is_at_rest_at_once(happened: Note) -> None:
    """A die released at rest on a face has landed, without an impact."""
    down = State(0.0, np.array([0.0, 0.0, CUBE.solid.inradius]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    result = throw_die(CUBE, down, SmoothImpact(0.5))
    assert (result.ending, result.impact_count) == (Ending.RESTED, 0)
    happened(f"landed on face {result.landed_face} after {result.impact_count} impacts")


@pytest.mark.parametrize(
    ("drag_per_m", "spin_rad_s", "height_m"),
    [
        pytest.param(1e-12, 30.0, 0.1, id="1e-12 per m"),
        pytest.param(10.0, 30.0, 0.1, id="10 per m"),
        pytest.param(1000.0, 30.0, 0.1, id="1000 per m"),
        pytest.param(0.03, 1e4, 0.1, id="10 000 rad/s"),
        pytest.param(0.03, 30.0, 1e5, id="from 100 km"),
    ],
)
@pytest.mark.parametrize("mu", [0.0, 0.3], ids=lambda mu: f"mu {mu:g}")
def test_a_throw_in_air_loses_energy_until_it_rests(
    drag_per_m: float, spin_rad_s: float, height_m: float, mu: float, happened: Note
) -> None:
    """Against air drag from 1e-12 to 1000 per metre, at 10 000 rad/s and from 100 km, a die gains no energy and comes to rest."""
    release = random_release(np.random.default_rng(2), CUBE, spin_rad_s=spin_rad_s, clearance_m=height_m)
    result = throw_die(CUBE, release, CoulombImpact(0.5, mu), drag_per_m=drag_per_m)
    energies = [energy_J(CUBE, state) for f in result.throw.flights for state in (f.start, f.at(f.end_s))]
    gained = max(0.0, *(b - a for a, b in itertools.pairwise(energies))) / energies[0]
    assert result.ending is Ending.RESTED
    # Steps of contact with friction add some 1e-6 (`throw.held_contact`).
    assert gained < (1e-5 if mu else 1e-12)
    first = result.throw.impacts[0]
    fallen = -result.throw.flights[0].at(first.time_s).velocity_m_s[2]
    happened(f"on face {result.landed_face} after {result.impact_count} impacts, the first at {fallen:.3g} m/s")


@pytest.mark.parametrize("drag_per_m", [-0.01, 1001.0, np.nan, np.inf], ids=lambda k: f"{k:g} per m")
def test_a_drag_that_no_air_has_is_refused(drag_per_m: float, happened: Note) -> None:
    """A drag below 0, above 1000 per metre, or not finite is refused."""
    release = random_release(np.random.default_rng(2), CUBE)
    with pytest.raises(ValueError, match="wanted 0 to 1000") as caught:
        throw_die(CUBE, release, SmoothImpact(0.5), drag_per_m=drag_per_m)
    happened(str(caught.value))


@pytest.mark.parametrize("throws", [1, 2000], ids=lambda n: f"{n} throw" + "s" * (n > 1))
def test_an_ensemble_of_any_size_lands_as_its_throws_do(throws: int, happened: Note) -> None:
    """An ensemble of 1 and of 2000 throws lands as the same throws one by one; the first five are compared."""
    rng = np.random.default_rng(5)
    states = [random_release(rng, CUBE) for _ in range(throws)]
    starts = np.array([[*s.position_m, *s.quaternion, *s.velocity_m_s, *s.omega_rad_s] for s in states])
    faces = ThrowSetup(CUBE, SmoothImpact(0.3)).throw(starts).face
    alone = [throw_die(CUBE, state, SmoothImpact(0.3)).landed_face for state in states[:5]]
    np.testing.assert_array_equal(faces[:5], alone)
    happened(f"{len(faces)} landed, the first on {faces[:5].tolist()}")


@pytest.mark.parametrize("step_s", [0.0, -1e-3, np.nan, np.inf], ids=lambda step: f"{step:g} s")
def test_a_step_that_is_none_is_refused(step_s: float, happened: Note) -> None:
    """Fixed steps that are not positive or not finite are refused."""
    with pytest.raises(ValueError, match="wanted a time above 0 s") as caught:
        stepped_landings(CUBE, 0.5, np.zeros((1, 13)), step_s)
    happened(str(caught.value))


NEEDLE, PLATE, NEARLY_CUBE = (1.0, 1.0, 1000.0), (1.0, 1000.0, 1000.0), (1.0, 1.000001, 1.000002)


@pytest.mark.parametrize("edges", [NEEDLE, PLATE, NEARLY_CUBE], ids=["1 to 1000", "1 to 1000 to 1000", "1 to 1.000002"])
def test_a_cuboid_of_any_proportions_tumbles_without_loss(edges: tuple[float, ...], happened: Note) -> None:
    """A cuboid of any proportions keeps energy and angular momentum through a hundred turns of free flight."""
    die = die_from_solid(named_solid("cuboid", edges_m=[1e-3 * edge for edge in edges]), 1e-3)
    turning = turning_of(die)
    assert isinstance(turning, TorqueFree)
    # Next to the middle axis, about which no rotation is stable.
    start = State(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([1.0, 100.0, 2.0]))
    turns = turns_in_flight(turning, start, np.linspace(0.0, 2.0 * np.pi, 201))
    rotation = matrix_from_quat(turns.quaternions)
    momentum = np.einsum("nij,nj->ni", rotation @ die.tensor_kg_m2 @ rotation.transpose(0, 2, 1), turns.omegas_rad_s)
    energy = np.einsum("ni,ni->n", momentum, turns.omegas_rad_s)
    lost, turned = float(np.abs(energy / energy[0] - 1.0).max()), float(np.abs(momentum - momentum[0]).max())
    turned /= float(np.linalg.norm(momentum[0]))
    # Each step loses 1e-17 of the energy by its method, and rounding. The needle takes millions of them: what it could turn
    # about its axis with the energy that it has chooses them, and steps chosen by what it does turn are unstable.
    assert lost < 1e-12
    assert turned < 1e-13
    happened(f"energy changed by {lost:.0e}, angular momentum by {turned:.0e} of themselves")


@pytest.mark.parametrize("edges", [NEEDLE, PLATE], ids=["1 to 1000", "1 to 1000 to 1000"])
@pytest.mark.parametrize("mu", [0.0, 0.3], ids=lambda mu: f"mu {mu:g}")
def test_a_needle_and_a_plate_come_to_rest(edges: tuple[float, ...], mu: float, happened: Note) -> None:
    """A needle and a plate come to rest on a face, with friction and without, and never gain energy."""
    die = die_from_solid(named_solid("cuboid", edges_m=[1e-4 * edge for edge in edges]), 1e-3)
    release = random_release(np.random.default_rng(5), die)
    result = throw_die(die, release, CoulombImpact(0.5, mu))
    energies = [energy_J(die, flight.start) for flight in result.throw.flights]
    assert result.ending is Ending.RESTED
    assert max(b / a - 1.0 for a, b in itertools.pairwise(energies)) < 1e-9
    happened(f"on face {result.landed_face} after {result.impact_count} impacts")
