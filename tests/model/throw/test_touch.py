"""The search for the first touch misses none, at any spin and any depth."""

import numpy as np
import pytest
from random_throws import DICE, random_quaternion, random_release
from scipy.optimize import brentq, minimize_scalar

from diethrow.model.rotations import matrix_from_quat
from diethrow.model.throw.motion import Flight, State
from diethrow.model.throw.touch import next_touch
from diethrow.model.world import GRAVITY_M_S2

SHAPES = list(DICE)


def heights(die, release: State, dt: np.ndarray) -> np.ndarray:
    """Heights (n, vertices) by the plainest way: matrices at every instant, nothing shared with the search."""
    positions, quaternions = Flight(release, np.inf).poses(release.time_s + np.atleast_1d(dt))
    return positions[:, 2, None] + matrix_from_quat(quaternions)[:, 2] @ die.solid.vertices.T


def raised(release: State, by_m: float) -> State:
    return State(
        release.time_s,
        release.position_m + np.array([0, 0, by_m]),
        release.quaternion,
        release.velocity_m_s,
        release.omega_rad_s,
    )


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("spin", [0.0, 1e-12, 3.0, 60.0, 1000.0])
def test_no_sample_of_the_flight_before_the_touch_lies_below_the_table(shape, spin):
    die, rng = DICE[shape], np.random.default_rng(21)
    for _ in range(8):
        release = random_release(rng, die, spin_rad_s=spin, clearance_m=float(rng.choice([1e-9, 1e-3, 0.1])))
        touch = next_touch(die, release)
        duration = touch.state.time_s - release.time_s
        before = heights(die, release, np.linspace(0.0, duration, 4000))
        # Rounding as the search states it: 16 ε of the height and of the arm with the phase that it has turned.
        limit = 16 * 2.2e-16 * (0.3 + die.solid.circumradius * (1 + spin * duration))
        assert before.min() > -limit
        assert before[-1].argmin() == touch.vertex
        assert abs(before[-1].min()) < limit
        assert touch.normal_velocity_m_s < 0


@pytest.mark.parametrize("shape", SHAPES)
def test_the_touch_is_the_first_crossing_that_dense_sampling_finds(shape):
    die, rng = DICE[shape], np.random.default_rng(22)
    for _ in range(10):
        release = random_release(rng, die, spin_rad_s=float(rng.uniform(0, 300)), clearance_m=0.02)
        dt = np.linspace(0.0, 0.5, 40001)
        below = heights(die, release, dt) < 0
        k = int(below.any(axis=1).argmax())
        vertex = int(below[k].argmax())
        crossing = brentq(lambda t, i=vertex, r=release: heights(die, r, t)[0, i], dt[k - 1], dt[k], xtol=1e-16)
        touch = next_touch(die, release)
        assert touch.vertex == vertex
        # 3e-15 m of height at some 0.5 m/s.
        assert touch.state.time_s - release.time_s == pytest.approx(crossing, abs=1e-13)


@pytest.mark.parametrize("depth_m", [1e-6, 1e-9, 1e-12])
def test_a_grazing_touch_is_found_and_a_grazing_miss_is_passed(depth_m):
    die, rng = DICE["cube"], np.random.default_rng(23)
    grazes = 0
    while grazes < 12:
        release = random_release(rng, die, spin_rad_s=float(rng.uniform(200, 2000)), clearance_m=0.01)
        dt = np.linspace(0.0, 0.04, 8001)
        lowest = heights(die, release, dt).min(axis=1)
        dips = [k for k in range(1, 8000) if lowest[k] < min(lowest[k - 1], lowest[k + 1])]
        if not dips or lowest[: dips[0]].min() < lowest[dips[0]]:
            continue
        k = dips[0]
        vertex = int(heights(die, release, dt[k])[0].argmin())
        dip = minimize_scalar(
            lambda t, i=vertex, r=release: heights(die, r, t)[0, i], bounds=(dt[k - 1], dt[k + 1]), method="bounded",
            options={"xatol": 1e-12},
        )  # fmt: skip
        touched = next_touch(die, raised(release, -dip.fun - depth_m))
        missed = next_touch(die, raised(release, -dip.fun + depth_m))
        assert touched.vertex == vertex
        # A dip of 1e-6 m into a curve that bends by ω²R is at most 0.1 ms wide.
        assert release.time_s + dip.x - 1e-4 < touched.state.time_s < release.time_s + dip.x
        assert missed.state.time_s > release.time_s + dt[k + 1]
        grazes += 1


def test_a_die_without_spin_touches_at_the_time_of_the_closed_form():
    die = DICE["icosahedron"]
    release = random_release(np.random.default_rng(24), die, spin_rad_s=0.0, clearance_m=0.3)
    v = release.velocity_m_s[2]
    fall = (v + np.sqrt(v * v + 2 * GRAVITY_M_S2 * 0.3)) / GRAVITY_M_S2
    touch = next_touch(die, release)
    assert touch.state.time_s - release.time_s == pytest.approx(fall, rel=1e-14)
    assert touch.normal_velocity_m_s == pytest.approx(v - GRAVITY_M_S2 * fall, rel=1e-14)


@pytest.mark.parametrize("spin", [1e-200, 1e-12, 1e4, 1e6])
def test_the_search_works_at_any_spin(spin):
    die = DICE["cube"]
    touch = next_touch(die, random_release(np.random.default_rng(25), die, spin_rad_s=spin))
    arm = touch.state.rotation @ die.solid.vertices[touch.vertex]
    # At 1e6 rad/s the phase ωt of 1e5 is itself rounded to 1e-11 rad, and so is the height, to 1e-13 m.
    assert abs(touch.state.position_m[2] + arm[2]) < 1e-12 if spin == 1e6 else 1e-14
    np.testing.assert_allclose(touch.arm_m, arm, atol=1e-16)


def on_one_vertex(spin_rad_s: float, velocity_m_s: float) -> State:
    """A cube on its lowest vertex, turning about a level axis; the vertex is at rest when the velocities cancel."""
    die = DICE["cube"]
    quaternion = random_quaternion(np.random.default_rng(26))
    arms = matrix_from_quat(quaternion) @ die.solid.vertices.T
    height = -arms[2].min()
    omega = spin_rad_s * np.array([1.0, 0.0, 0.0])
    rise = -np.cross(omega, arms[:, arms[2].argmin()])[2]
    return State(0.0, np.array([0, 0, height]), quaternion, np.array([0, 0, rise + velocity_m_s]), omega)


@pytest.mark.parametrize("spin", [0.0, 5.0, 400.0])
@pytest.mark.parametrize("speed", [1e-6, 1e-2, 1.0])
def test_a_vertex_that_has_just_left_the_table_does_not_touch_again_at_once(spin, speed):
    touch = next_touch(DICE["cube"], on_one_vertex(spin, speed))
    assert touch.state.time_s > 0
    # Without spin the flight is that of a stone.
    if spin == 0.0:
        assert touch.state.time_s == pytest.approx(2 * speed / GRAVITY_M_S2, rel=1e-8)


def test_a_vertex_at_rest_touches_if_it_accelerates_down_and_leaves_if_the_spin_lifts_it():
    touch = next_touch(DICE["cube"], on_one_vertex(5.0, 0.0))
    assert (touch.state.time_s, touch.normal_velocity_m_s) == (0.0, 0.0)
    # The vertex circles upwards with ω² R, far above g at 400 rad/s.
    assert next_touch(DICE["cube"], on_one_vertex(400.0, 0.0)).state.time_s > 1e-4


@pytest.mark.parametrize("below_m", [1e-17, 1e-15, 1e-12])
def test_a_rising_vertex_that_rounding_left_below_the_table_does_not_touch(below_m):
    touch = next_touch(DICE["cube"], raised(on_one_vertex(5.0, 0.1), -below_m))
    assert touch.state.time_s > 1e-3


def test_the_search_can_skip_the_first_part_of_a_flight_and_end_at_a_given_time():
    die = DICE["cube"]
    release = random_release(np.random.default_rng(27), die)
    touch = next_touch(die, release)
    duration = touch.state.time_s - release.time_s
    later = next_touch(die, release, after_s=0.5 * duration)
    assert later.vertex == touch.vertex
    assert later.state.time_s == pytest.approx(touch.state.time_s, abs=1e-14)
    assert next_touch(die, release, until_s=touch.state.time_s - 1e-9) is None
    assert next_touch(die, release, after_s=duration, until_s=release.time_s) is None


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("position_m", [0.0, np.nan, 0.1], "position_m = .*wanted 3 finite numbers"),
        ("velocity_m_s", [0.0, 0.0], "velocity_m_s = .*wanted 3 finite numbers"),
        ("omega_rad_s", [0.0, 0.0, np.inf], "omega_rad_s = .*wanted 3 finite numbers"),
        ("quaternion", [0.5, 0.5, 0.5, 0.6], "quaternion of length 1.05.*unit quaternion wxyz"),
        ("time_s", np.nan, "time_s = nan"),
    ],
)
def test_an_impossible_state_raises_and_names_the_field(field, value, named):
    good = random_release(np.random.default_rng(28), DICE["cube"])
    fields = {k: getattr(good, k) for k in ("time_s", "position_m", "quaternion", "velocity_m_s", "omega_rad_s")}
    with pytest.raises(ValueError, match=named):
        next_touch(DICE["cube"], State(**{**fields, field: np.asarray(value) if field != "time_s" else value}))
