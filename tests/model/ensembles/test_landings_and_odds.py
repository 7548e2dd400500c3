"""Many throws: reproducible counts, fair odds of symmetric dice, Wilson intervals, and chunks in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from diethrow.model.die.die import loaded_die, make_die
from diethrow.model.die.solid import SHAPES
from diethrow.model.ensembles.landings import ENDING_OF_INDEX, ThrowSetup, chunks_in_order
from diethrow.model.ensembles.odds import Share, Tally, tally_throws
from diethrow.model.ensembles.releases import (
    BLOCK,
    CONDITIONS,
    Conditions,
    PaperConditions,
    UniformConditions,
    drawn_states,
    states_of,
)
from diethrow.model.laws import CoulombImpact, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_euler
from diethrow.model.throw.body import body_of, unpacked_state
from diethrow.model.throw.simulate import Ending, throw_die

CUBE = make_die("cube", 0.02, 0.016)
SETUP = ThrowSetup(CUBE, SmoothImpact(0.5))
UNIFORM = UniformConditions(40.0, (0.1, 0.4))
PAPER = PaperConditions((0.0, 40.0, 0.0), (0.3, 0.4))


def last_tally(setup: ThrowSetup, conditions: Conditions, throws: int, seed: int = 1, **how: int) -> Tally:
    *_, tally = tally_throws(setup, conditions, throws, seed, **how)
    return tally


def assert_same(a: Tally, b: Tally) -> None:
    for name in Tally.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("conditions", [UNIFORM, PAPER])
def test_counts_do_not_depend_on_threads_or_chunks(conditions: Conditions) -> None:
    # Across the end of a block, so that chunks begin and end within blocks.
    throws = BLOCK + 700
    whole = last_tally(SETUP, conditions, throws, after=2)
    assert whole.throws == throws
    assert_same(whole, last_tally(SETUP, conditions, throws, after=2, threads=3, chunk=1000))
    assert_same(whole, last_tally(SETUP, conditions, throws, after=2, threads=2, chunk=777))


def test_a_tally_that_was_stopped_continues_to_the_same_counts() -> None:
    whole = last_tally(SETUP, UNIFORM, 2500, after=1)
    parts = tally_throws(SETUP, UNIFORM, 2500, 1, after=1, chunk=300)
    stopped = [next(parts) for _ in range(4)][-1]
    parts.close()
    assert stopped.throws == 900
    assert_same(whole, last_tally(SETUP, UNIFORM, 2500, after=1, begun=stopped, chunk=450))


def test_a_seed_always_gives_the_same_throws() -> None:
    # The first releases of seed 1: published results name their seed, so this must not change.
    assert BLOCK == 4096
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence(1, spawn_key=(0,))))
    np.testing.assert_array_equal(
        drawn_states(UNIFORM, CUBE, 1, 0, 9)[:, 2], 0.1 + (0.4 - 0.1) * random.random(BLOCK)[:9]
    )


def test_a_release_is_the_same_for_every_split_into_ranges() -> None:
    across = drawn_states(PAPER, CUBE, 7, BLOCK - 3, 2 * BLOCK + 5)
    for k in (0, 2, 3, BLOCK + 2, BLOCK + 3, BLOCK + 7):
        np.testing.assert_array_equal(drawn_states(PAPER, CUBE, 7, BLOCK - 3 + k, BLOCK - 2 + k)[0], across[k])
    assert not np.array_equal(drawn_states(PAPER, CUBE, 8, 0, 5), drawn_states(PAPER, CUBE, 7, 0, 5))


def test_many_throws_land_as_they_do_one_by_one() -> None:
    states = drawn_states(UNIFORM, CUBE, 3, 0, 60)
    many = SETUP.throw(states, after=3)
    for k, state in enumerate(states):
        alone = throw_die(CUBE, unpacked_state(state, 0.0), SETUP.law)
        assert many.face[k] == (alone.landed_face or 0)
        assert ENDING_OF_INDEX[many.ending[k]] is alone.ending
        struck = [impact.time_s for impact in alone.throw.bounces][:3]
        for n, time_s in enumerate(struck, 1):
            down = CUBE.solid.normals @ matrix_from_quat(alone.throw.at(time_s).quaternion)[2]
            assert down[many.lowest[k, n] - 1] <= down.min() + 1e-9  # equal but for the rounding of an instant


@pytest.mark.parametrize("shape", SHAPES)
def test_uniform_orientations_and_directions_of_spin_make_fair_dice(shape: str) -> None:
    # The symmetries of the die carry each face onto each other, and leave these conditions as they are.
    die = make_die(shape, 0.02, 0.016)
    tally = last_tally(ThrowSetup(die, SmoothImpact(0.3)), UniformConditions(30.0, (0.1, 0.2)), 6000, seed=11)
    expected = tally.rested / len(tally.landed)
    statistic = ((tally.landed - expected) ** 2).sum() / expected
    # Of five shapes and one seed: a fair die would fail once in 10 000 seeds a shape.
    assert chi2.sf(statistic, len(tally.landed) - 1) > 1e-4
    assert tally.rested + tally.endings[[e is not Ending.RESTED for e in ENDING_OF_INDEX]].sum() == tally.throws


def test_a_loaded_die_lands_on_its_heavy_side_more_often() -> None:
    # A fifth of the mass close below face 1.
    heavy = loaded_die(CUBE.solid, 0.016, 0.004, 0.9 * CUBE.solid.normals[0] * CUBE.solid.inradius)
    tally = last_tally(ThrowSetup(heavy, SmoothImpact(0.2)), UniformConditions(20.0, (0.05, 0.1)), 400)
    low, _ = Share(int(tally.landed[0]), tally.rested, 0.999).interval
    assert low > 1 / 6
    assert tally.landed[0] == tally.landed.max()


def test_spinning_dice_are_counted_separately_and_friction_stops_them() -> None:
    upright = PaperConditions((0.0, 0.0, 400.0), (0.3, 0.4))
    smooth = last_tally(SETUP, upright, 300)
    assert smooth.endings[ENDING_OF_INDEX.index(Ending.SPINNING)] > 0
    assert smooth.rested + smooth.endings.sum() - smooth.endings[0] == 300
    rough = last_tally(ThrowSetup(CUBE, CoulombImpact(0.5, 0.3)), upright, 60)
    assert rough.rested == 60


def test_elastic_throws_are_counted_as_bouncing() -> None:
    elastic = last_tally(ThrowSetup(CUBE, SmoothImpact(1.0)), UNIFORM, 20)
    assert elastic.endings[ENDING_OF_INDEX.index(Ending.BOUNCING)] == 20
    assert elastic.rested == 0


def test_a_tilted_table_is_the_level_one_in_its_own_axes() -> None:
    table = Table(tilt_rad=0.2, downhill_rad=0.5)
    setup = ThrowSetup(CUBE, SmoothImpact(0.3), table)
    states = drawn_states(UNIFORM, CUBE, 5, 0, 20)
    many = setup.throw(states)
    for k, state in enumerate(states):
        alone = throw_die(CUBE, unpacked_state(state, 0.0), setup.law, table=table)
        # The faces alone: turned in another order of sums, a throw differs by rounding, and so may its last faint impacts.
        assert many.face[k] == (alone.landed_face or 0)


@pytest.mark.parametrize(("count", "of"), [(0, 1), (1, 1), (0, 40), (40, 40), (1, 30), (7, 50), (164321, 1_000_000)])
@pytest.mark.parametrize("level", [0.8, 0.95, 0.999])
def test_intervals_are_wilsons(count: int, of: int, level: float) -> None:
    """The bounds p solve |count/of - p| = z √(p (1 - p)/of); at the ends they are exactly 0 and 1."""
    bounds = np.array(Share(count, of, level).interval)
    assert bounds[0] == 0.0 or count > 0
    assert bounds[1] == 1.0 or count < of
    inner = bounds[(bounds > 0.0) & (bounds < 1.0)]
    z = norm.ppf(0.5 + 0.5 * level)
    np.testing.assert_allclose(np.abs(count / of - inner), z * np.sqrt(inner * (1 - inner) / of), rtol=1e-9)


def test_the_interval_of_no_throws_is_everything() -> None:
    assert Share(0, 0).interval == (0.0, 1.0)


def test_the_papers_conditions_agree_with_the_functions_of_rotations() -> None:
    rng = np.random.default_rng(2)
    numbers = rng.normal(size=(50, len(CONDITIONS)))
    states = states_of(numbers)
    turn = matrix_from_quat(quat_from_euler(numbers[:, 1:4]))
    np.testing.assert_allclose(matrix_from_quat(states[:, 3:7]), turn, atol=1e-14)
    np.testing.assert_allclose(states[:, 10:13], (turn @ numbers[:, 7:, None])[:, :, 0], atol=1e-13)
    np.testing.assert_array_equal(states[:, 7:10], numbers[:, 4:7])
    np.testing.assert_array_equal(states[:, :3], np.stack([0 * numbers[:, 0], 0 * numbers[:, 0], numbers[:, 0]], 1))


def test_uniform_orientations_have_no_preferred_direction() -> None:
    states = drawn_states(UNIFORM, CUBE, 4, 0, 2 * BLOCK)
    n = len(states)
    for vectors in (matrix_from_quat(states[:, 3:7])[:, :, 2], states[:, 10:13] / 40.0):
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-12)
        # Of a uniform direction: mean 0 and second moments 1/3, each off by at most 5 standard errors.
        assert np.abs(vectors.mean(0)).max() < 5 * np.sqrt(1 / 3 / n)
        assert np.abs((vectors.T @ vectors) / n - np.eye(3) / 3).max() < 5 * np.sqrt(4 / 45 / n)
    assert states[:, 2].min() >= 0.1
    assert states[:, 2].max() <= 0.4


def test_releases_that_could_begin_below_the_table_raise() -> None:
    with pytest.raises(ValueError, match=r"0\.01 m"):
        last_tally(SETUP, UniformConditions(40.0, (0.01, 0.4)), 10)


def test_impossible_conditions_and_counts_raise() -> None:
    with pytest.raises(ValueError, match="wanted the lower bound first"):
        UniformConditions(1.0, (0.4, 0.3))
    with pytest.raises(ValueError, match="wanted finite numbers"):
        PaperConditions((0.0, np.nan, 0.0), (0.3, 0.4))
    with pytest.raises(ValueError, match="3"):
        _ = Share(3, 2).interval


def test_a_failing_chunk_raises_in_its_turn_and_ends_the_others() -> None:
    def work(i: int, j: int) -> int:
        if i == 30:
            raise ValueError("the thirtieth")
        return j

    parts = chunks_in_order(work, 0, 1000, 10, 3)
    assert [next(parts)[1] for _ in range(3)] == [10, 20, 30]
    with pytest.raises(ValueError, match="the thirtieth"):
        next(parts)


def test_a_loaded_die_with_friction_lands_on_its_heavy_side_more_often() -> None:
    loaded = replace(CUBE, centre_of_mass_m=np.array([0.0, 0.0, 0.003]))
    heavy = int(np.argmax(loaded.solid.normals[:, 2])) + 1
    starts = drawn_states(UNIFORM, loaded, 0, 0, 60)
    landed = ThrowSetup(loaded, CoulombImpact(0.4, 0.3)).throw(starts).face
    # A fair die does so in 17 or more of 60 throws with odds of 2 in 100; this one has no other stable side to speak of.
    assert (landed == heavy).sum() >= 17
    assert (landed > 0).all()


def test_an_isotropic_inertia_is_found_wherever_the_centre_of_mass_lies() -> None:
    assert CUBE.isotropic_inertia_kg_m2 == CUBE.inertia_kg_m2
    assert replace(CUBE, centre_of_mass_m=np.array([0.0, 0.0, 0.003])).isotropic_inertia_kg_m2 == pytest.approx(
        CUBE.inertia_kg_m2
    )
    assert loaded_die(CUBE.solid, 0.016, 0.004, [0.0, 0.0, 0.008]).isotropic_inertia_kg_m2 is None
    with pytest.raises(ValueError, match="deeper inside the cube"):
        body_of(replace(make_die("cube", 0.02, 0.016, corner_radius_m=0.008), centre_of_mass_m=np.array([0, 0, 0.003])))
