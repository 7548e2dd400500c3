"""Ensembles: the same throws however they are shared out, fair odds where symmetry demands them, known exponents."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

from diethrow.model.die.die import loaded_die, make_die
from diethrow.model.die.solid import SHAPES
from diethrow.model.ensembles.basins import Axis, Window, final_configurations, map_rows
from diethrow.model.ensembles.landings import ENDING_OF_INDEX, ThrowSetup, chunks_in_order, drawn_states
from diethrow.model.ensembles.odds import Tally, tally_throws, wilson_interval
from diethrow.model.ensembles.predictability import (
    GROUPS,
    fairness_by_dynamics,
    final_state_sensitivity,
    uncertainty_exponent,
)
from diethrow.model.ensembles.releases import (
    BLOCK,
    CONDITIONS,
    Conditions,
    PaperConditions,
    UniformConditions,
    states_of,
)
from diethrow.model.laws import CoulombImpact, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_euler
from diethrow.model.throw.body import body_of
from diethrow.model.throw.simulate import Ending, Until, throw_die
from diethrow.model.throw.touch import unpacked_state

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.02, 0.016)
STAGE = ThrowSetup(CUBE, SmoothImpact(0.5))
UNIFORM = UniformConditions(40.0, (0.1, 0.4))
PAPER = PaperConditions((0.0, 40.0, 0.0), (0.3, 0.4))
WINDOW = Window(Axis("z0", 0.1, 0.4, 24), Axis("omega_eta", 0.0, 50.0, 30))
TETRAHEDRON = ThrowSetup(make_die("tetrahedron", 0.040793, 0.016), SmoothImpact(0.2))


def last_tally(stage: ThrowSetup, conditions: Conditions, throws: int, seed: int = 1, **how: int) -> Tally:
    *_, tally = tally_throws(stage, conditions, throws, seed, **how)
    return tally


def assert_same(a: Tally, b: Tally) -> None:
    for name in Tally.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("conditions", [UNIFORM, PAPER])
def test_counts_do_not_depend_on_threads_or_chunks(conditions: Conditions) -> None:
    # Over the border of a block, so that chunks begin and end within one.
    throws = BLOCK + 700
    whole = last_tally(STAGE, conditions, throws, after=2)
    assert whole.throws == throws
    assert_same(whole, last_tally(STAGE, conditions, throws, after=2, threads=3, chunk=1000))
    assert_same(whole, last_tally(STAGE, conditions, throws, after=2, threads=2, chunk=777))


def test_a_tally_that_was_stopped_goes_on_to_the_same_counts() -> None:
    whole = last_tally(STAGE, UNIFORM, 2500, after=1)
    parts = tally_throws(STAGE, UNIFORM, 2500, 1, after=1, chunk=300)
    stopped = [next(parts) for _ in range(4)][-1]
    parts.close()
    assert stopped.throws == 900
    assert_same(whole, last_tally(STAGE, UNIFORM, 2500, after=1, begun=stopped, chunk=450))


def test_a_seed_keeps_its_throws() -> None:
    # The first release of seed 1: results written down elsewhere name their seed, so this must not change.
    assert BLOCK == 4096
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence(1, spawn_key=(0,))))
    np.testing.assert_array_equal(
        drawn_states(UNIFORM, CUBE, 1, 0, 9)[:, 2], 0.1 + (0.4 - 0.1) * random.random(BLOCK)[:9]
    )


def test_a_release_is_the_same_however_it_is_asked_for() -> None:
    across = drawn_states(PAPER, CUBE, 7, BLOCK - 3, 2 * BLOCK + 5)
    for k in (0, 2, 3, BLOCK + 2, BLOCK + 3, BLOCK + 7):
        np.testing.assert_array_equal(drawn_states(PAPER, CUBE, 7, BLOCK - 3 + k, BLOCK - 2 + k)[0], across[k])
    assert not np.array_equal(drawn_states(PAPER, CUBE, 8, 0, 5), drawn_states(PAPER, CUBE, 7, 0, 5))


def test_many_throws_land_as_they_do_one_by_one() -> None:
    states = drawn_states(UNIFORM, CUBE, 3, 0, 60)
    many = STAGE.throw(states, after=3)
    for k, state in enumerate(states):
        alone = throw_die(CUBE, unpacked_state(state, 0.0), STAGE.law)
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


def test_a_load_makes_its_side_land_more_often() -> None:
    # A fifth of the mass close below face 1.
    heavy = loaded_die(CUBE.solid, 0.016, 0.004, 0.9 * CUBE.solid.normals[0] * CUBE.solid.inradius)
    tally = last_tally(ThrowSetup(heavy, SmoothImpact(0.2)), UniformConditions(20.0, (0.05, 0.1)), 400)
    low, _ = wilson_interval(int(tally.landed[0]), tally.rested, 0.999)
    assert low > 1 / 6
    assert tally.landed[0] == tally.landed.max()


def test_tops_are_counted_apart_and_friction_stops_them() -> None:
    upright = PaperConditions((0.0, 0.0, 400.0), (0.3, 0.4))
    smooth = last_tally(STAGE, upright, 300)
    assert smooth.endings[ENDING_OF_INDEX.index(Ending.SPINNING)] > 0
    assert smooth.rested + smooth.endings.sum() - smooth.endings[0] == 300
    rough = last_tally(ThrowSetup(CUBE, CoulombImpact(0.5, 0.3)), upright, 60)
    assert rough.rested == 60


def test_what_bounces_for_ever_is_said_to() -> None:
    elastic = last_tally(ThrowSetup(CUBE, SmoothImpact(1.0)), UNIFORM, 20)
    assert elastic.endings[ENDING_OF_INDEX.index(Ending.BOUNCING)] == 20
    assert elastic.rested == 0


def test_a_tilted_table_is_the_level_one_in_its_own_axes() -> None:
    table = Table(tilt_rad=0.2, downhill_rad=0.5)
    stage = ThrowSetup(CUBE, SmoothImpact(0.3), table)
    states = drawn_states(UNIFORM, CUBE, 5, 0, 20)
    many = stage.throw(states)
    for k, state in enumerate(states):
        alone = throw_die(CUBE, unpacked_state(state, 0.0), stage.law, table=table)
        # The faces alone: turned in another order of sums, a throw differs by rounding, and so may its last faint impacts.
        assert many.face[k] == (alone.landed_face or 0)


@pytest.mark.parametrize(("count", "of"), [(0, 1), (1, 1), (0, 40), (40, 40), (1, 30), (7, 50), (164321, 1_000_000)])
@pytest.mark.parametrize("level", [0.8, 0.95, 0.999])
def test_intervals_are_wilsons(count: int, of: int, level: float) -> None:
    wanted = binomtest(count, of).proportion_ci(confidence_level=level, method="wilson")
    # Both are sums of a few doubles.
    np.testing.assert_allclose(wilson_interval(count, of, level), (wanted.low, wanted.high), rtol=1e-12, atol=1e-15)


def test_the_interval_of_nothing_is_everything() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_the_papers_conditions_are_states_as_elsewhere() -> None:
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


def test_releases_that_could_begin_below_the_table_are_refused() -> None:
    with pytest.raises(ValueError, match="below the table; wanted a higher lowest release"):
        last_tally(STAGE, UniformConditions(40.0, (0.01, 0.4)), 10)


def test_conditions_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="wanted the lower bound first"):
        UniformConditions(1.0, (0.4, 0.3))
    with pytest.raises(ValueError, match="wanted finite numbers"):
        PaperConditions((0.0, np.nan, 0.0), (0.3, 0.4))
    with pytest.raises(ValueError, match="wanted 0 <= count <= of"):
        wilson_interval(3, 2)


def test_work_that_fails_says_so_and_ends_the_others() -> None:
    def work(i: int, j: int) -> int:
        if i == 30:
            raise ValueError("the thirtieth")
        return j

    parts = chunks_in_order(work, 0, 1000, 10, 3)
    assert [next(parts)[1] for _ in range(3)] == [10, 20, 30]
    with pytest.raises(ValueError, match="the thirtieth"):
        next(parts)


# --- maps ----------------------------------------------------------------------------------------------------------


def whole_map(stage: ThrowSetup, window: Window, rows: int = 8, threads: int = 1) -> NDArray[np.int64]:
    faces = np.concatenate([part.face for _, _, part in map_rows(stage, window, rows=rows, threads=threads)])
    return faces.reshape(window.y.pixels, window.x.pixels)


def test_a_zoom_is_the_crop_of_a_finer_map_pixel_for_pixel() -> None:
    # 0.2 and 0.3 are no doubles; a coordinate off in its last bit would show at this restitution.
    stage = ThrowSetup(TETRAHEDRON.die, SmoothImpact(0.7))
    finer = Window(Axis("z0", 0.1, 0.4, 90), Axis("omega_eta", 10.0, 40.0, 60))
    zoom = Window(Axis("z0", 0.2, 0.3, 30), Axis("omega_eta", 15.0, 25.0, 20))
    np.testing.assert_array_equal(zoom.x.centres, finer.x.centres[30:60])
    np.testing.assert_array_equal(whole_map(stage, zoom), whole_map(stage, finer)[10:30, 30:60])


def test_a_map_does_not_depend_on_threads_or_rows_at_once() -> None:
    expected = whole_map(TETRAHEDRON, WINDOW)
    np.testing.assert_array_equal(whole_map(TETRAHEDRON, WINDOW, rows=7, threads=3), expected)


def test_a_pixel_is_the_throw_from_its_centre() -> None:
    faces = whole_map(TETRAHEDRON, WINDOW)
    for row, column in ((0, 0), (3, 20), (17, 11), (29, 23)):
        z0, eta = WINDOW.x.centres[column], WINDOW.y.centres[row]
        quaternion = quat_from_euler([0.3, 1.2, 0.6])
        omega = matrix_from_quat(quaternion) @ [0.0, eta, 0.0]
        release = unpacked_state(np.concatenate([[0.0, 0.0, z0], quaternion, np.zeros(3), omega]), 0.0)
        assert throw_die(TETRAHEDRON.die, release, TETRAHEDRON.law).landed_face == faces[row, column]


def test_a_release_below_the_table_is_no_throw() -> None:
    window = Window(Axis("z0", 0.0, 0.1, 10), Axis("theta", 0.0, 3.0, 4))
    (_, _, part), *_ = map_rows(TETRAHEDRON, window, rows=4)
    low = (part.ending == -1).reshape(4, 10)
    assert low[:, 0].all()
    assert not low[:, -1].any()
    assert (part.face[part.ending == -1] == 0).all()


def test_outcomes_name_what_is_no_face_by_its_ending() -> None:
    stage = ThrowSetup(CUBE, SmoothImpact(1.0))
    bounces = -1 - ENDING_OF_INDEX.index(Ending.BOUNCING)
    points = np.array([[0.3, 20.0], [0.2, 1.0]])
    assert final_configurations(stage, WINDOW, points).tolist() == [bounces, bounces]
    alone = throw_die(CUBE, unpacked_state(WINDOW.states(points)[0], 0.0), stage.law, until=Until(impacts=4))
    down = CUBE.solid.normals @ matrix_from_quat(alone.throw.at(alone.throw.bounces[3].time_s).quaternion)[2]
    assert final_configurations(stage, WINDOW, points, after=4)[0] == int(down.argmin()) + 1


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Axis("z", 0.0, 1.0, 3), "wanted one of z0, psi"),
        (lambda: Axis("z0", 1.0, 1.0, 3), "the lower one first"),
        (lambda: Axis("z0", 0.0, 1.0, 0), "wanted 1 or more"),
        (lambda: Window(Axis("z0", 0.1, 1.0, 3), Axis("z0", 0.1, 1.0, 3)), "two different ones"),
        (lambda: Window(Axis("z0", 0.1, 1.0, 3), Axis("psi", 0.1, 1.0, 3), {"tetha": 1.0}), "fixed condition 'tetha'"),
        (lambda: Window(Axis("z0", 0.1, 1.0, 100_000), Axis("psi", 0.1, 1.0, 100_000)), "wanted at most"),
    ],
)
def test_windows_that_cannot_be_are_refused(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()


# --- predictability ------------------------------------------------------------------------------------------------


def halves(points: Array) -> NDArray[np.int64]:
    """A smooth boundary: a circle."""
    return 1 + (((points - 0.5) ** 2).sum(1) < 0.09).astype(np.int64)


def cantor(points: Array) -> NDArray[np.int64]:
    """Gaps of the middle-third Cantor set, by the parity of the step at which they were cut out."""
    x, label = points[:, 0].copy(), np.zeros(len(points), np.int64)
    for step in range(40):
        x *= 3.0
        digit = np.floor(x)
        label[(label == 0) & (digit == 1)] = 1 + step % 2
        x -= digit
    return np.where(label == 0, 1, label)


def test_a_smooth_boundary_has_uncertainty_exponent_1() -> None:
    sensitivity = final_state_sensitivity(halves, [0, 0], [1, 1], np.logspace(-3.5, -1.5, 9), conditions=40_000, seed=5)
    exponent = uncertainty_exponent(sensitivity)
    assert exponent is not None
    assert exponent.standard_error < 0.03
    assert abs(exponent.value - 1.0) < 3 * exponent.standard_error + 0.01  # the circle is not straight at 0.03
    assert exponent.boundary_dimension == 2.0 - exponent.value
    # f is the area of the points within ε of the circle along either axis: 2 ε times the two projections, less overlap.
    assert sensitivity.shares[0].interval[0] < 2.4 * np.sqrt(2) * 10**-3.5 < sensitivity.shares[0].interval[1] * 1.1


def test_the_cantor_set_has_its_known_exponent() -> None:
    # Sizes over whole periods of 1/3, in which f of this basin is a power of ε times a periodic function of log ε.
    sizes = 3.0 ** -np.arange(3.0, 11.0, 0.25)
    exponent = uncertainty_exponent(final_state_sensitivity(cantor, [0], [1], sizes, conditions=60_000, seed=2))
    assert exponent is not None
    # D = ln 2/ln 3 in one dimension; 0.02 for the range, which does not hold a whole number of periods of every size.
    assert abs(exponent.value - (1.0 - np.log(2) / np.log(3))) < 3 * exponent.standard_error + 0.02
    assert exponent.standard_error < 0.03


def test_sensitivity_does_not_depend_on_threads_and_tells_the_deciding_size() -> None:
    one = final_state_sensitivity(halves, [0, 0], [1, 1], [1e-3, 1e-2, 0.1, 1.0], conditions=2000, seed=3)
    three = final_state_sensitivity(halves, [0, 0], [1, 1], [1.0, 1e-3, 1e-2, 0.1], conditions=2000, seed=3, threads=3)
    np.testing.assert_array_equal(one.uncertain, three.uncertain)
    np.testing.assert_array_equal(one.decided, three.decided)
    assert one.decided.sum() == GROUPS * one.conditions >= 2000
    # At most 2 × 1.2 × 2 ε of the square lies as near as that to the circle, along either axis.
    assert one.deciding_epsilon(0.9) == 1e-2
    assert one.deciding_epsilon(0.99) == 1e-3
    # Even at 1e-3, some 0.3 % lie across.
    assert one.deciding_epsilon(0.9999) is None


def test_without_a_boundary_there_is_no_exponent() -> None:
    def all_alike(points: Array) -> NDArray[np.int64]:
        return np.ones(len(points), np.int64)

    sensitivity = final_state_sensitivity(all_alike, [0, 0], [1, 1], [1e-3, 1e-2, 1e-1], conditions=100)
    assert uncertainty_exponent(sensitivity) is None
    assert sensitivity.deciding_epsilon(1.0) == 0.1


def test_measures_of_balls_are_areas() -> None:
    ball = fairness_by_dynamics(halves, [0.8, 0.5], [1.0, 1.0], 2, [1e-4, 0.05], throws=20_000, seed=1)
    assert ball.counts.sum(1).tolist() == [20_000, 20_000]
    # On the circle a small ball is cut in halves; 5 standard errors of a share of one half.
    assert np.abs(ball.measures[0] - 0.5).max() < 5 * 0.5 / np.sqrt(20_000)
    assert ball.p_value[0] > 1e-4
    away = fairness_by_dynamics(halves, [0.1, 0.1], [1.0, 1.0], 2, [0.05], throws=200)
    assert away.counts.tolist() == [[200, 0]]
    # All on one of two: χ² = n exactly.
    assert away.chi_square.tolist() == [200.0]
    assert away.p_value[0] < 1e-40


def test_what_lands_on_no_face_has_no_measure() -> None:
    def none(points: Array) -> NDArray[np.int64]:
        return np.full(len(points), -3)

    ball = fairness_by_dynamics(none, [0.0], [1.0], 6, [0.1], throws=50)
    assert ball.none.tolist() == [50]
    assert np.isnan(ball.measures).all()
    assert ball.chi_square.tolist() == [0.0]


def test_sizes_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="wanted sizes above 0"):
        final_state_sensitivity(halves, [0, 0], [1, 1], [1e-3, 0.0])


def test_a_throw_at_small_restitution_is_predictable_as_the_paper_defines_it() -> None:
    # Few bounces, so that basins are open sets: at 1e-6 of the window nearly every neighbour lands alike.
    stage = ThrowSetup(TETRAHEDRON.die, SmoothImpact(0.05))

    def outcome(points: Array) -> NDArray[np.int64]:
        return final_configurations(stage, WINDOW, points)

    sensitivity = final_state_sensitivity(outcome, [0.1, 0.0], [0.4, 50.0], [1e-6], conditions=256)
    assert sensitivity.shares[0].value < 0.02


def test_a_loaded_die_that_rubs_lands_on_its_heavy_side_more_often() -> None:
    loaded = replace(CUBE, centre_of_mass_m=np.array([0.0, 0.0, 0.003]))
    heavy = int(np.argmax(loaded.solid.normals[:, 2])) + 1
    starts = drawn_states(UNIFORM, loaded, 0, 0, 60)
    landed = ThrowSetup(loaded, CoulombImpact(0.4, 0.3)).throw(starts).face
    # A fair die does so in 17 or more of 60 throws with odds of 2 in 100; this one has no other stable side to speak of.
    assert (landed == heavy).sum() >= 17
    assert (landed > 0).all()


def test_one_moment_of_inertia_is_told_wherever_the_mass_lies() -> None:
    assert CUBE.isotropic_inertia_kg_m2 == CUBE.inertia_kg_m2
    assert replace(CUBE, centre_of_mass_m=np.array([0.0, 0.0, 0.003])).isotropic_inertia_kg_m2 == pytest.approx(
        CUBE.inertia_kg_m2
    )
    assert loaded_die(CUBE.solid, 0.016, 0.004, [0.0, 0.0, 0.008]).isotropic_inertia_kg_m2 is None
    with pytest.raises(ValueError, match="deeper inside the cube"):
        body_of(replace(make_die("cube", 0.02, 0.016, corner_radius_m=0.008), centre_of_mass_m=np.array([0, 0, 0.003])))
