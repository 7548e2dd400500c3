"""What a throw may combine: every door accepts what the table says, refuses the rest alike, and the documents show that table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diethrow.model.die import Die
from diethrow.model.die.die import die_from_solid, make_die
from diethrow.model.die.solid import convex_solid
from diethrow.model.ensembles import ThrowSetup
from diethrow.model.laws import CoulombImpact, FrictionBySpeed, ImpactLaw, RestitutionBySpeed, SmoothImpact, Table
from diethrow.model.rotations import quat_from_rotvec, rotation_between
from diethrow.model.throw import (
    BodyKind,
    Door,
    Ending,
    State,
    Until,
    body_kind,
    energy_J,
    packed_state,
    propagate,
    support_table,
    throw_die,
)
from diethrow.model.throw.supported import SUPPORTED, Action

BOX = convex_solid([(x, y, z) for x in (-0.006, 0.006) for y in (-0.008, 0.008) for z in (-0.01, 0.01)])
OFFSET_M = np.array([0.001, -0.0005, 0.002])


def die_of(kind: BodyKind, corner_radius_m: float = 0.0) -> Die:
    if kind is BodyKind.ASYMMETRIC:
        return die_from_solid(BOX, 0.01, corner_radius_m=corner_radius_m)
    cube = make_die("cube", 0.016, 0.0045, corner_radius_m=corner_radius_m)
    return replace(cube, centre_of_mass_m=OFFSET_M, is_homogeneous=False) if kind is BodyKind.LOADED else cube


LAWS: dict[frozenset[Action], ImpactLaw] = {
    frozenset(): SmoothImpact(0.5),
    frozenset({Action.FRICTION}): CoulombImpact(0.5, 0.2),
    frozenset({Action.RESTITUTION_BY_SPEED}): RestitutionBySpeed(SmoothImpact(0.5), 1.0),
    frozenset({Action.FRICTION, Action.RESTITUTION_BY_SPEED}): RestitutionBySpeed(CoulombImpact(0.5, 0.2), 1.0),
    frozenset(Action) - {Action.DRAG}: FrictionBySpeed(RestitutionBySpeed(CoulombImpact(0.5, 0.2), 1.0), 1.0),
}
TABLES = {"level": Table(), "tilted": Table(tilt_rad=0.05), "oscillating": Table(amplitude_m=1e-4, frequency_hz=30.0)}
each_kind = pytest.mark.parametrize("kind", list(BodyKind), ids=lambda kind: kind.name)
each_law = pytest.mark.parametrize(
    "actions", list(LAWS), ids=lambda some: "+".join(a.name for a in Action if a in some) or "SMOOTH"
)


def release(die: Die) -> State:
    return State(
        0.0,
        np.array([0.0, 0.0, 0.05]),
        quat_from_rotvec([0.4, -0.7, 0.2]),
        np.array([0.2, 0.1, -0.5]),
        np.array([9, -14, 6]),
    )


@each_kind
def test_each_die_is_of_its_kind(kind):
    assert body_kind(die_of(kind)) is kind


@each_kind
@each_law
@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES.keys())
@pytest.mark.parametrize("radius", [0.0, 0.001])
def test_every_door_accepts_what_the_table_says_and_refuses_the_rest(kind, actions, table, radius):
    die, law = die_of(kind, radius), LAWS[actions]
    start = release(die)

    def single(drag_per_m: float = 0.0) -> None:
        throw_die(die, start, law, until=Until(impacts=2), table=table, drag_per_m=drag_per_m)

    def ensemble(drag_per_m: float = 0.0) -> None:
        if table is TABLES["level"]:
            ThrowSetup(die, law, table, drag_per_m=drag_per_m).throw(packed_state(start)[None])
        else:
            single(drag_per_m)

    def derivatives(drag_per_m: float = 0.0) -> None:
        propagate(die, start, law, [0.02, 0.1], vertices=[0], table=table, drag_per_m=drag_per_m)

    doors = [(Door.THROW, actions, single), (Door.THROW, actions, ensemble), (Door.DERIVATIVES, actions, derivatives)]
    doors += [(Door.THROW, actions | {Action.DRAG}, lambda call=call: call(0.05)) for call in (single, ensemble)]
    doors += [(Door.DERIVATIVES, actions | {Action.DRAG}, lambda: derivatives(0.05))]
    for door, wanted, call in doors:
        too_much = wanted - SUPPORTED[door][kind]
        if too_much:
            with pytest.raises(
                ValueError, match=f"{sorted(too_much, key=list(Action).index)[0].value}.*{kind.value}.*wanted"
            ):
                call()
        else:
            call()


def test_the_documents_show_the_table():
    document = (Path(__file__).parents[3] / "docs" / "model.md").read_text(encoding="utf-8")
    assert support_table() in document


@pytest.mark.parametrize("radius", [0.0, 0.0015])
def test_a_loaded_die_with_vanishing_friction_moves_as_one_with_smooth_impacts(radius):
    """Two engines: with friction that of one moment of inertia about the centre of mass, without that of any tensor."""
    die = die_of(BodyKind.LOADED, radius)
    for spin in ([9, -14, 6], [-20, 3, 11]):
        start = replace(release(die), omega_rad_s=np.array(spin, float))
        smooth = throw_die(die, start, SmoothImpact(0.6), until=Until(impacts=4)).throw
        rough = throw_die(die, start, CoulombImpact(0.6, 1e-13), until=Until(impacts=4)).throw
        assert [i.vertices for i in rough.impacts] == [i.vertices for i in smooth.impacts]
        for one, two in zip(rough.impacts, smooth.impacts, strict=True):
            np.testing.assert_allclose(one.point_m, two.point_m, atol=1e-9)
            assert one.energy_after_J == pytest.approx(two.energy_after_J, rel=1e-9)
            assert one.normal_velocity_after_m_s == pytest.approx(two.normal_velocity_after_m_s, abs=1e-8)
        times = np.linspace(0.0, smooth.flights[-1].end_s - 1e-6, 50)
        (p, q), (other_p, other_q) = rough.poses(times), smooth.poses(times)
        np.testing.assert_allclose(p, other_p, atol=1e-9)
        np.testing.assert_allclose(rotation_between(q, other_q), 0.0, atol=1e-7)


def test_a_loaded_die_with_friction_lands_as_its_ensemble_says_and_never_gains_energy():
    die, law, rng = die_of(BodyKind.LOADED), CoulombImpact(0.5, 0.3), np.random.default_rng(8)
    faces = []
    for _ in range(20):
        start = replace(
            release(die), quaternion=quat_from_rotvec(rng.normal(size=3)), omega_rad_s=20.0 * rng.normal(size=3)
        )
        result = throw_die(die, start, law)
        assert result.ending is Ending.RESTED
        landing = ThrowSetup(die, law).throw(packed_state(start)[None])
        assert landing.face[0] == result.landed_face
        faces.append(result.landed_face)
        energies = [energy_J(die, f.at(t)) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
        # Keeping turned vertices at the table's height adds to the energy in rolling contact (`held_contact`).
        assert np.diff(energies).max() < 1e-5 * energies[0]
    assert len(set(faces)) > 2
