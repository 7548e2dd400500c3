"""Growth of errors, Lyapunov exponents, and decidability in double precision."""

import numpy as np
import pytest
from random_throws import DICE, disturbed, random_quaternion, random_release, state_difference

from diethrow.model import engine
from diethrow.model.die.die import make_die
from diethrow.model.engine import derivatives
from diethrow.model.ensembles.chaos import (
    decidable_in_double_precision,
    decidable_in_double_precision_many,
    error_growth,
    largest_lyapunov_exponent,
)
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.laws import LEVEL, CoulombImpact, RestitutionBySpeed, SmoothImpact, Table
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_from_euler,
    quat_from_rotvec,
)
from diethrow.model.throw.body import body_of, checked_release, unpacked_state
from diethrow.model.throw.motion import State
from diethrow.model.throw.simulate import Ending, Precision, Until, throw_die

SHAKEN = Table(amplitude_m=0.002, frequency_hz=25.0, phase_rad=0.7)
CUBE = DICE["cube"]
ELASTIC = ThrowSetup(CUBE, SmoothImpact(1.0))
LAWS = {
    "smooth": SmoothImpact(0.6),
    "coulomb": CoulombImpact(0.6, 0.15),
    "by speed": RestitutionBySpeed(SmoothImpact(0.7), 2.0),
}
each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())


def units(die, table=LEVEL) -> np.ndarray:
    """(12,) R, 1 rad, √(g R), √(g/R)."""
    return derivatives.scales_of(body_of(die), table.plane)


def logged(die, start: State, law, table: Table, impacts: int | None):
    """Log and knots of a throw, as the kernels write them, and its derivatives after each event."""
    packed, of_law = checked_release(die, start, table), engine.law_of(law.code, law.parameters)
    setup = engine.Setup(body_of(die), of_law, table.plane, engine.FINE)
    limits = engine.Limits(np.inf, engine.NO_LIMIT if impacts is None else impacts, 10**7, impacts is None)
    _, _, _, _, _, log, knots = engine.run_throw(setup, packed, start.time_s, limits, True)
    maps, exponents = derivatives.run_growth(setup, packed, start.time_s, log, knots)
    assert not exponents.any()
    return log, maps


def differences(die, start: State, law, table: Table, event: int, step: float, until: Until) -> np.ndarray:
    """(12, 12) central differences, in units of `units`, of the state right after an event, at the same instant in all:
    the flight that follows it is extended to the instant of the undisturbed event."""
    unit, columns = units(die, table), []
    when = throw_die(die, start, law, table=table, until=until).throw.impacts[event].time_s
    for column in range(12):
        sides = [
            throw_die(die, disturbed(start, sign * step * unit * np.eye(12)[column]), law, table=table, until=until)
            for sign in (1, -1)
        ]
        a, b = (side.throw.flights[event + 1].at(when) for side in sides)
        columns.append(state_difference(b, a) / (2 * step * unit))
    return np.array(columns).T


@pytest.mark.parametrize(
    ("die", "law", "seed"),
    [
        *(pytest.param(die, LAWS["smooth"], 81, id=shape) for shape, die in DICE.items()),
        # The kernels difference laws without derivatives.
        *(pytest.param(CUBE, law, 83, id=f"cube, {name}") for name, law in LAWS.items()),
    ],
)
@pytest.mark.parametrize("table", [LEVEL, SHAKEN], ids=["at rest", "oscillating"])
def test_derivatives_of_a_throw_agree_with_differences(die, law, seed, table):
    start = random_release(np.random.default_rng(seed), die)
    _, maps = logged(die, start, law, table, 3)
    found = differences(die, start, law, table, 2, 1e-7, Until(impacts=3))
    # A step of 1e-7, magnified up to a thousandfold, bends by 1e-8; rounding of 1e-15 over it is as much.
    np.testing.assert_allclose(maps[2], found, atol=1e-5 * np.abs(found).max())


def test_differences_of_a_law_give_its_derivative():
    """Friction with μ = 0 is the smooth impact, differentiated in another way."""
    start = random_release(np.random.default_rng(84), CUBE)
    _, smooth = logged(CUBE, start, SmoothImpact(0.6), SHAKEN, 5)
    _, rough = logged(CUBE, start, CoulombImpact(0.6, 0.0), SHAKEN, 5)
    # The differences are right to 1e-10 an impact.
    for one, other in zip(rough, smooth, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(other).max())


def test_growth_through_chatter_and_held_contact_is_that_of_differences():
    law, rng, checked = SmoothImpact(0.2), np.random.default_rng(85), 0
    for _ in range(200):
        start = random_release(rng, CUBE)
        log, maps = logged(CUBE, start, law, LEVEL, None)
        held = np.flatnonzero((log[:, 21] >= 0) & (log[:, 22] != -2))
        later = np.flatnonzero((log[:, 1] >= 0) & (log[:, 21] < 0))
        if not (len(held) and len(later) and later[-1] > held[0]):
            continue
        event = int(later[later > held[0]][0])
        if np.linalg.norm(maps[event], 2) > 1e4 or abs(log[event, 0] - log[event - 1, 0]) < 1e-4:
            continue
        try:
            found = differences(
                CUBE, start, law, LEVEL, event, 1e-8, Until(time_s=float(log[event, 0]) + start.time_s + 9.0)
            )
        except IndexError:  # a neighbour has another number of bounces before it chatters
            continue
        # Rounding that has come through the collapse, 1e-14 of the state, over a step of 1e-8.
        if np.abs(found).max() < 1e5:
            np.testing.assert_allclose(maps[event], found, atol=1e-3 * np.abs(found).max())
            checked += 1
        if checked == 3:
            return
    pytest.fail(f"only {checked} throws of 200 could be compared")


@each_die
@pytest.mark.parametrize("table", [LEVEL, SHAKEN], ids=["at rest", "oscillating"])
def test_every_impact_contracts_the_volume_by_chi_squared(die, table):
    """Flight keeps it; of the two directions along the impulse, position and momentum, each shrinks by χ."""
    start = random_release(np.random.default_rng(86), die)
    _, maps = logged(die, start, SmoothImpact(0.7), table, 4)
    for k, each in enumerate(maps[:4]):
        # Directions that shrink as much as others grow are known to the rounding of the latter.
        lost = 1e-15 * np.linalg.cond(each)
        assert np.linalg.det(each) == pytest.approx(0.7 ** (2 * (k + 1)), rel=1e-9 + lost)


def paper_start() -> State:
    """Fig. 5 of Kapitaniak et al."""
    quaternion = quat_from_euler([0.001, 0.00001, 0.0001])
    spin = matrix_from_quat(quaternion) @ np.array([0.0, 60.0, 0.0])
    return State(0.0, np.array([0.0, 0.0, 0.3]), quaternion, np.array([0.6, 0.0, -0.7]), spin)


def spectrum(die, law, table: Table, impacts: int) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the growth (impacts, 12) and the instants (impacts,)."""
    logs, clock = np.empty((impacts, 12)), np.empty(impacts)
    tangent = np.random.default_rng(1).normal(size=(12, 12)) * units(die, table)[:, None]
    setup = engine.Setup(body_of(die), engine.law_of(law.code, law.parameters), table.plane, engine.FINE)
    derivatives.run_exponents(setup, checked_release(die, paper_start(), table), 0.0, tangent, logs, clock)
    return logs, clock


def test_without_loss_the_exponents_are_pairs_of_opposite_sign():
    logs, clock = spectrum(CUBE, SmoothImpact(1.0), LEVEL, 4000)
    exponents = logs[100:].sum(0) / (clock[-1] - clock[99])
    # Neutral directions grow as log t / t: ln(1e4)/900 s; the pairs themselves differ by their beginnings over 900 s.
    np.testing.assert_allclose(exponents + exponents[::-1], 0.0, atol=0.05)
    np.testing.assert_allclose(exponents[2:10], 0.0, atol=0.05)
    assert exponents[0] > 5.0
    # Volume: exact but for rounding.
    assert abs(logs[1:].sum(1)).max() < 1e-6


def test_with_loss_the_exponents_add_up_to_two_log_chi_an_impact():
    logs, _ = spectrum(CUBE, SmoothImpact(0.8), SHAKEN, 2000)
    assert logs[1:].sum() / (len(logs) - 1) == pytest.approx(2 * np.log(0.8), rel=1e-3)


@pytest.mark.parametrize(
    ("shape", "edge_m", "per_second", "per_impact"), [("tetrahedron", 0.040793, 11.0, 1.9), ("cube", 0.02, 12.1, 2.9)]
)
def test_the_largest_exponent_at_chi_one_equals_the_known_value_from_two_neighbours(
    shape, edge_m, per_second, per_impact
):
    die = make_die(shape, edge_m, 0.016)
    found = largest_lyapunov_exponent(ThrowSetup(die, SmoothImpact(1.0)), paper_start(), impacts=3000, orbits=3)
    assert found.per_second == pytest.approx(per_second, abs=0.15 + 3 * found.per_second_error)
    assert found.per_impact == pytest.approx(per_impact, abs=0.05 + 3 * found.per_impact_error)
    assert found.per_unit == pytest.approx(found.per_second * np.sqrt(edge_m / 9.81))


@pytest.mark.parametrize(("chi", "table"), [(1.0, LEVEL), (0.8, SHAKEN)], ids=["elastic", "driven"])
def test_the_exponent_is_that_of_two_neighbouring_throws(chi, table):
    """Independently of the tangent map: two throws 1e-8 apart, brought back together every 0.06 s."""
    law, unit, step_s, apart_by = SmoothImpact(chi), units(CUBE, table), 0.06, 1e-8
    one = paper_start()
    two = disturbed(one, apart_by * unit * np.eye(12)[10])
    logs = []
    for _ in range(900):
        until = Until(time_s=one.time_s + step_s)
        one, two = (throw_die(CUBE, each, law, table=table, until=until).throw.at(until.time_s) for each in (one, two))
        gap = state_difference(one, two) / unit
        logs.append(np.log(np.linalg.norm(gap) / apart_by))
        two = disturbed(one, gap / np.linalg.norm(gap) * apart_by * unit)
    rates = np.array(logs[50:]).reshape(-1, 10).mean(1) / step_s
    found = largest_lyapunov_exponent(ThrowSetup(CUBE, law, table), paper_start(), impacts=3000, orbits=3)
    error = np.hypot(found.per_second_error, rates.std(ddof=1) / np.sqrt(len(rates)))
    assert rates.mean() == pytest.approx(found.per_second, abs=3 * error)


def test_a_bouncing_point_mass_has_no_positive_exponent():
    body = body_of(CUBE)._replace(vertices=np.zeros((1, 3)))
    start = np.array([0, 0, 0.3, 1, 0, 0, 0, 0.1, 0, 0, 1.0, 2.0, 3.0])
    logs, clock = np.empty((4000, 1)), np.empty(4000)
    tangent = np.random.default_rng(2).normal(size=(12, 1)) * derivatives.scales_of(body, engine.LEVEL)[:, None]
    law = engine.law_of(engine.SMOOTH, np.array([1.0]))
    derivatives.run_exponents(engine.Setup(body, law, engine.LEVEL, engine.FINE), start, 0.0, tangent, logs, clock)
    # A difference in energy shifts the bounces in proportion to time: ln(4000)/4000.
    assert abs(logs[10:].sum()) / 4000 < 2 * np.log(4000) / 4000


def test_the_exponent_scales_with_the_size_of_the_die_through_its_unit_alone():
    small = largest_lyapunov_exponent(ELASTIC, paper_start(), impacts=50, orbits=1, left_out=0)
    large_start = State(
        0.0,
        100 * paper_start().position_m,
        paper_start().quaternion,
        10 * paper_start().velocity_m_s,
        paper_start().omega_rad_s / 10,
    )
    die = make_die("cube", 2.0, 0.016)
    large = largest_lyapunov_exponent(ThrowSetup(die, SmoothImpact(1.0)), large_start, impacts=50, orbits=1, left_out=0)
    # The orbits are the same until rounding has grown by e^2.9 an impact: compare the first eight.
    np.testing.assert_allclose(large.logs[0, :8], small.logs[0, :8], rtol=1e-4)


def test_a_motion_without_an_exponent_raises_and_names_the_reason():
    with pytest.raises(ValueError, match=r"chi = 0\.5 on a table at rest"):
        largest_lyapunov_exponent(ThrowSetup(CUBE, SmoothImpact(0.5)), paper_start())
    with pytest.raises(ValueError, match="orbits = 0"):
        largest_lyapunov_exponent(ELASTIC, paper_start(), orbits=0)
    weak = Table(amplitude_m=1e-5, frequency_hz=10.0)
    with pytest.raises(ValueError, match=r"the die bounced only .* times"):
        largest_lyapunov_exponent(ThrowSetup(CUBE, SmoothImpact(0.3), weak), paper_start())


def on_an_edge(tilt_rad: float) -> State:
    """A cube at rest on an edge, tilted from its balance."""
    turn = quat_from_rotvec([np.pi / 4 + tilt_rad, 0.0, 0.0])
    height = -(CUBE.solid.vertices @ matrix_from_quat(turn)[2]).min()
    return State(0.0, np.array([0.0, 0.0, height]), turn, np.zeros(3), np.zeros(3))


def test_a_die_dropped_by_a_millimetre_onto_a_face_is_decidable():
    start = State(0.0, np.array([0.0, 0.0, 0.011]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    check = decidable_in_double_precision(ThrowSetup(CUBE, SmoothImpact(0.5)), start)
    assert check.decidable
    assert check.margin > 1e6


def test_a_die_that_is_tilted_on_an_edge_is_decidable_and_one_tilted_by_rounding_is_not():
    setup = ThrowSetup(CUBE, SmoothImpact(0.3))
    assert decidable_in_double_precision(setup, on_an_edge(1e-3)).decidable
    for tilt_rad in (0.0, 1e-15, -3e-16):
        check = decidable_in_double_precision(setup, on_an_edge(tilt_rad))
        assert not check.decidable, (tilt_rad, check)
        assert check.margin <= 1.0


def test_a_throw_of_hundreds_of_elastic_bounces_is_not_decidable_because_errors_grow():
    check = decidable_in_double_precision(ELASTIC, paper_start())
    assert not check.decidable
    assert check.error_growth > 1e16
    grown = error_growth(ELASTIC, paper_start(), impacts=20)
    assert grown.ending is Ending.IMPACTS_REACHED
    assert len(grown.at_impacts) == 20
    # e^2.9 an impact on average, with a wide spread.
    assert 15 < grown.log10_growth[-1] < 40


def random_starts(count: int, seed: int) -> np.ndarray:
    """Packed starts (count, 13) of the cube, 0.3 m up, 40 rad/s."""
    rng, starts = np.random.default_rng(seed), np.zeros((count, 13))
    starts[:, 2] = 0.3
    starts[:, 3:7] = [random_quaternion(rng) for _ in starts]
    axes = rng.normal(size=(count, 3))
    starts[:, 10:] = 40.0 * axes / np.linalg.norm(axes, axis=1)[:, None]
    return starts


@pytest.mark.parametrize(("chi", "least_share"), [(0.3, 0.99), (0.5, 0.95), (0.7, 0.4)])
def test_every_throw_whose_face_a_tolerance_changes_is_found_not_decidable(chi, least_share):
    starts, law = random_starts(3000, 90), SmoothImpact(chi)
    (fine, _, _), (coarse, decidable, _) = (
        decidable_in_double_precision_many(ThrowSetup(CUBE, law, precision=Precision(contact_tolerance_m=root)), starts)
        for root in (1e-13, 1e-11)
    )
    assert not ((fine[:, 0] != coarse[:, 0]) & decidable).any()
    assert decidable.mean() > least_share
    if chi == 0.7:  # a tolerance does change faces
        assert (fine[:, 0] != coarse[:, 0]).mean() > 0.03


def test_many_throws_together_have_the_decidability_and_the_face_of_each_alone():
    starts, setup = random_starts(20, 91), ThrowSetup(CUBE, SmoothImpact(0.6))
    landed, decidable, _ = decidable_in_double_precision_many(setup, starts)
    for k, start in enumerate(starts):
        release = unpacked_state(start, 0.0)
        assert decidable_in_double_precision(setup, release).decidable == decidable[k]
        assert throw_die(CUBE, release, setup.law).landed_face == landed[k, 0] + 1


@each_law
@pytest.mark.parametrize("table", [LEVEL, Table(tilt_rad=0.1), SHAKEN], ids=["at rest", "tilted", "oscillating"])
def test_every_law_and_table_has_an_answer(law, table):
    start = random_release(np.random.default_rng(92), CUBE)
    check = decidable_in_double_precision(ThrowSetup(CUBE, law, table), start)
    assert np.isfinite(check.error_growth)
    assert check.error_growth > 1.0
    assert isinstance(check.decidable, bool)
    assert check.decidable == (check.margin > 1.0) or "left before its end" in check.sentence
