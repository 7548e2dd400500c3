"""Derivatives of a throw by everything that it depends on: each law, table and die against differences."""

from dataclasses import replace

import numpy as np
import pytest
from random_throws import disturbed, random_quaternion, random_release
from scipy.integrate import solve_ivp

from diethrow.model import engine
from diethrow.model.die.die import Die, die_from_solid, loaded_die, make_die
from diethrow.model.die.named_solids import truncated_dipyramid
from diethrow.model.engine import derivatives
from diethrow.model.laws import LEVEL, CoulombImpact, FrictionBySpeed, RestitutionBySpeed, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.body import unpacked_state
from diethrow.model.throw.motion import State
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.model.throw.tangent import PARAMETERS, Propagation, propagate
from diethrow.model.world import GRAVITY_M_S2

LAWS = {
    "smooth": SmoothImpact(0.6),
    "smooth by speed": RestitutionBySpeed(SmoothImpact(0.7), 2.0),
    "newton": CoulombImpact(0.6, 0.15, "newton"),
    "poisson": CoulombImpact(0.6, 0.15, "poisson"),
    "stronge": CoulombImpact(0.6, 0.15, "stronge"),
    "algebraic": CoulombImpact(0.6, 0.15, "algebraic"),
    "sticks": CoulombImpact(0.5, 0.6),
    "rough by speed": RestitutionBySpeed(CoulombImpact(0.7, 0.2), 2.0),
}
SWAYING = Table(0.05, -2.0, 0.0005, 30.0, 0.3)
ROUNDED = {s: make_die(s, 0.02, 0.016, corner_radius_m=0.0015) for s in ("cube", "tetrahedron", "icosahedron")}
OFF_CENTRE = replace(make_die("tetrahedron", 0.02, 0.016), centre_of_mass_m=np.array([1e-3, 2e-4, -3e-4]))
TOPS = {
    "fair": make_die("cube", 0.02, 0.016, corner_radius_m=0.001),
    "loaded": loaded_die(make_die("cube", 0.02, 0.016).solid, 0.016, 0.004, [4e-3, 2e-3, -3e-3], corner_radius_m=0.001),
    "dipyramid": die_from_solid(truncated_dipyramid(5, 0.012, 0.014, 0.3), 0.01),
    "off centre": OFF_CENTRE,
}
OF_LAW = ("chi", "mu", "speed_scale_m_s")
OF_CENTRE = ("centre_of_mass_x_m", "centre_of_mass_y_m", "centre_of_mass_z_m")
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())

Model = tuple[Die, object, Table, float]
"""Die, law, table and drag [1/m] of a throw."""


def changed(model: Model, name: str, step: float) -> Model:
    """The same with one parameter moved by `step`."""
    die, law, table, drag = model
    if name in ("chi", "mu") and isinstance(law, RestitutionBySpeed):
        law = replace(law, law=replace(law.law, **{name: getattr(law.law, name) + step}))
    elif name in OF_LAW:
        law = replace(law, **{name: getattr(law, name) + step})
    elif name in OF_CENTRE:
        shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m.copy()
        shift[OF_CENTRE.index(name)] += step
        mean = die.inertia_kg_m2 if die.is_spherical_top else 1.0  # the tensor is what counts, where there is one
        die = replace(die, inertia_kg_m2=mean, centre_of_mass_m=shift)
    elif name == "inertia_kg_m2" and not die.is_spherical_top:
        die = replace(die, inertia_kg_m2=1.0, inertia_tensor_kg_m2=die.inertia_tensor_kg_m2 + step * np.eye(3))
    elif name == "inertia_kg_m2":
        die = replace(die, inertia_kg_m2=die.inertia_kg_m2 + step)
    elif name == "corner_radius_m":
        mean = die.inertia_kg_m2 if die.is_spherical_top else 1.0
        die = replace(die, inertia_kg_m2=mean, corner_radius_m=die.corner_radius_m + step)
    elif name.startswith("tilt"):
        turn = quat_from_rotvec([step, 0.0, 0.0] if name == "tilt_x_rad" else [0.0, step, 0.0])
        x, y, z = matrix_from_quat(quat_multiply(turn, table.world_from_table))[:, 2]
        table = replace(table, tilt_rad=float(np.arctan2(np.hypot(x, y), z)), downhill_rad=float(np.arctan2(y, x)))
    elif name == "drag_per_m":
        drag += step
    else:
        name = name.removeprefix("table_")
        table = replace(table, **{name: getattr(table, name) + step})
    return die, law, table, drag


def a_throw(model: Model, seed: int, impacts: int) -> tuple[State, list[int], np.ndarray]:
    """A release, the vertices of its first bounces, and times between them, not next to any."""
    die, law, table, _ = model
    start = random_release(np.random.default_rng(seed), die)
    throw = throw_die(die, start, law, until=Until(impacts=impacts), table=table).throw
    assert all(impact.contact == "vertex" for impact in throw.impacts)
    times = [np.linspace(f.start.time_s, f.end_s, 6)[1:-1] for f in throw.flights if f.end_s - f.start.time_s > 1e-3]
    return start, [impact.vertices[0] for impact in throw.impacts], np.concatenate(times)


def run(model: Model, start: State, times: np.ndarray, vertices: list[int] | None, names=("chi",)) -> Propagation:
    die, law, table, drag = model
    return propagate(die, start, law, times, vertices=vertices, table=table, drag_per_m=drag, parameters=names)


def assert_derivatives(model: Model, names: tuple[str, ...], seed: int, rtol: float, impacts: int = 3) -> Propagation:
    """Compare every column with differences, extrapolated to no step by Richardson's rule; those of `names` act."""
    start, vertices, times = a_throw(model, seed, impacts)
    result = run(model, start, times, vertices, names)
    assert len(result.impact_times_s) == impacts
    for column in range(12 + len(names)):
        # No pose moves by more than 0.3 mrad or 0.3 mm, where the fourth order leaves 1e-9 of the derivative.
        size = 3e-4 / max(1.0, np.abs(result.jacobian[:, :, column]).max())
        runs = {}
        for k in (-2, -1, 1, 2):
            if column < 12:
                runs[k] = run(model, disturbed(start, k * size * np.eye(12)[column]), times, vertices)
            else:
                runs[k] = run(changed(model, names[column - 12], k * size), start, times, vertices)

        def half(k: int, runs=runs) -> tuple[np.ndarray, np.ndarray]:
            a, b = runs[k], runs[-k]
            turned = rotation_between(b.quaternions, a.quaternions)
            return np.hstack([a.positions_m - b.positions_m, turned]), a.impact_times_s - b.impact_times_s

        poses, instants = ((8 * near - far) / (12 * size) for near, far in zip(half(1), half(2), strict=True))
        assert np.abs(poses).max() > 0
        np.testing.assert_allclose(result.jacobian[:, :, column], poses, atol=rtol * np.abs(poses).max(), rtol=0)
        limit = rtol * np.abs(instants).max() + 1e-15 / size
        np.testing.assert_allclose(result.impact_jacobian[:, column], instants, atol=limit, rtol=0)
    return result


def names_of(law) -> tuple[str, ...]:
    """The parameters that a law has."""
    names = ("chi", "mu") if law.code in (engine.COULOMB, engine.COULOMB_BY_SPEED) else ("chi",)
    return (*names, "speed_scale_m_s") if isinstance(law, RestitutionBySpeed) else names


@each_law
@pytest.mark.parametrize("die", ROUNDED.values(), ids=ROUNDED.keys())
def test_derivatives_by_start_and_parameters_agree_with_differences(die, law):
    # Friction's own differences leave 1e-10 of each impact, and three impacts multiply errors a thousandfold.
    of_table = tuple(name for name in PARAMETERS if name.startswith(("table", "tilt")))
    names = (*names_of(law), "corner_radius_m", "inertia_kg_m2", *of_table)
    assert_derivatives((die, law, SWAYING, 0.0), names, 7, 2e-6)


def test_derivatives_on_a_level_table_at_rest_need_no_corner_radius():
    for law in (LAWS["smooth"], LAWS["stronge"]):
        names = (*names_of(law), "inertia_kg_m2")
        assert_derivatives((make_die("cube", 0.02, 0.016), law, LEVEL, 0.0), names, 7, 2e-6)


@pytest.mark.parametrize("law", ["smooth", "smooth by speed", "stronge", "sticks", "rough by speed"])
@pytest.mark.parametrize("table", [LEVEL, SWAYING], ids=["level", "swaying"])
@pytest.mark.parametrize("name", TOPS)
def test_derivatives_of_asymmetric_dice_agree_with_differences(name, table, law):
    die = TOPS[name]
    names = (*names_of(LAWS[law]), *OF_CENTRE)
    if name in ("fair", "off centre"):
        names += ("inertia_kg_m2",)
    if die.corner_radius_m:
        names += ("corner_radius_m",)
    if table is SWAYING:
        names += ("tilt_x_rad", "tilt_y_rad", "table_amplitude_m", "table_frequency_hz", "table_phase_rad")
    # Steps of the attitude end elsewhere in each run: 1e-13 of jitter, multiplied by three impacts and over the step.
    # Nor does any of these throws graze the table, where differences of any step tell little.
    assert_derivatives((die, LAWS[law], table, 0.0), names, 8 if name == "dipyramid" else 7, 1e-5)


@pytest.mark.parametrize("law", [LAWS["smooth"], LAWS["stronge"]], ids=["smooth", "stronge"])
def test_derivatives_with_drag_agree_with_differences(law):
    names = (*names_of(law), "corner_radius_m", "tilt_x_rad", "tilt_y_rad", "table_amplitude_m", "drag_per_m")
    assert_derivatives((ROUNDED["cube"], law, SWAYING, 0.2), names, 7, 2e-6, impacts=2)


@each_law
@pytest.mark.parametrize("table", [LEVEL, SWAYING], ids=["level", "swaying"])
@pytest.mark.parametrize("die", [ROUNDED["cube"], make_die("icosahedron", 0.02, 0.016)], ids=["rounded", "sharp"])
def test_the_propagated_throw_is_the_throw_of_the_event_loop(die, table, law):
    model = (die, law, table, 0.0)
    start, vertices, times = a_throw(model, 7, 3)
    throw = throw_die(die, start, law, until=Until(impacts=3), table=table).throw
    positions, quaternions = throw.poses(times)
    for given in (vertices, None):
        result = run(model, start, times, given)
        # Rounding alone, of 1e-16, multiplied by three impacts.
        np.testing.assert_allclose(result.positions_m, positions, atol=1e-12)
        np.testing.assert_allclose(rotation_between(result.quaternions, quaternions), 0, atol=1e-11)
        np.testing.assert_allclose(result.throw.poses(times)[0], positions, atol=1e-12)
        before = [impact.energy_before_J for impact in result.throw.impacts]
        np.testing.assert_allclose(before, [i.energy_before_J for i in throw.impacts[: len(before)]], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "law"),
    [("loaded", "smooth"), ("dipyramid", "smooth"), *(("off centre", law) for law in LAWS)],
)
def test_the_propagated_throw_of_an_asymmetric_die_is_the_throw_of_the_event_loop(name, law):
    """With friction and with laws by speed the event loop is that of one moment of inertia: two engines."""
    model = (TOPS[name], LAWS[law], SWAYING, 0.0)
    start, vertices, times = a_throw(model, 7, 3)
    throw = throw_die(TOPS[name], start, LAWS[law], until=Until(impacts=3), table=SWAYING).throw
    positions, quaternions = throw.poses(times)
    for given in (vertices, None):
        result = run(model, start, times, given)
        # The attitude is integrated, to 1e-13 or so in each flight, and three impacts multiply that.
        np.testing.assert_allclose(result.positions_m, positions, atol=1e-9)
        np.testing.assert_allclose(rotation_between(result.quaternions, quaternions), 0, atol=1e-8)
        np.testing.assert_allclose(result.throw.poses(times)[0], result.positions_m, atol=1e-9)
        at_impact = result.throw.flights[1].at(result.throw.flights[1].start.time_s)
        np.testing.assert_allclose(at_impact.omega_rad_s, result.throw.flights[1].start.omega_rad_s, rtol=1e-9)


def test_a_derivative_by_the_centre_of_mass_does_not_change_the_throw_of_a_fair_die():
    die = ROUNDED["cube"]
    model = (die, LAWS["smooth"], SWAYING, 0.0)
    start, vertices, times = a_throw(model, 7, 3)
    plain = run(model, start, times, vertices)
    asked = run(model, start, times, vertices, ("chi", *OF_CENTRE))
    np.testing.assert_allclose(asked.positions_m, plain.positions_m, atol=1e-8)
    relative = 1e-7 * np.abs(plain.jacobian).max()
    np.testing.assert_allclose(asked.jacobian[:, :, :13], plain.jacobian, atol=relative)


def test_flight_with_drag_agrees_with_another_integrator():
    model = (ROUNDED["cube"], LAWS["smooth"], LEVEL, 0.5)
    start, vertices, _ = a_throw(model, 7, 1)
    start = replace(start, velocity_m_s=np.array([0.3, 0.0, 1.5]))  # up first, and slow at the top
    flight = run(model, start, np.array([start.time_s]), vertices).throw.flights[0]

    def rates(_, y):
        fall = np.array([0.0, 0.0, -GRAVITY_M_S2])
        return np.concatenate([y[3:], fall - 0.5 * np.linalg.norm(y[3:]) * y[3:]])

    begin = np.concatenate([start.position_m, start.velocity_m_s])
    span = (start.time_s, start.time_s + 0.3)
    expected = solve_ivp(rates, span, begin, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    # The error of either at the top, where |v| is 0.3 m/s and turns within 0.03 s.
    np.testing.assert_allclose(flight.poses([span[1]])[0][0], expected[:3], atol=1e-11)
    np.testing.assert_allclose(flight.at(span[1]).velocity_m_s, expected[3:], atol=1e-10)


def test_air_with_zero_drag_changes_nothing():
    model = (ROUNDED["cube"], LAWS["stronge"], SWAYING, 0.0)
    start, vertices, times = a_throw(model, 7, 3)
    for given in (vertices, None):
        still = run(model, start, times, given, ("chi",))
        asked = run(model, start, times, given, ("chi", "drag_per_m"))
        np.testing.assert_allclose(asked.positions_m, still.positions_m, atol=1e-11)
        np.testing.assert_allclose(asked.jacobian[:, :, :13], still.jacobian, atol=1e-8 * np.abs(still.jacobian).max())


@pytest.mark.parametrize(
    ("mu", "contact"),
    [
        pytest.param(0.05, (1.0, 0.4, -0.8), id="slides through"),
        pytest.param(0.3, (-0.12, 0.1, -0.8), id="stops and sets out again"),
        pytest.param(0.9, (0.3, 0.1, -1.0), id="sticks"),
        pytest.param(0.2, (-0.3, 0.05, -1.0), id="reverses"),
        pytest.param(0.3, (0.12, 0.1, -0.8), id="turns"),
        pytest.param(0.0, (0.3, 0.1, -1.0), id="no friction yet"),
    ],
)
@pytest.mark.parametrize("chi", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["one moment", "tensor"])
def test_the_gradient_of_an_impulse_agrees_with_larger_differences_for_every_kind_of_slip(mu, contact, chi, kind):
    mass, arm = 0.016, (0.006, -0.003, -0.012)
    law = engine.RoughLaw(engine.COULOMB, np.array([chi, mu, float(engine.STRONGE)]))
    attitude, moments = matrix_from_quat(random_quaternion(np.random.default_rng(1))), np.array([0.8, 1.07, 1.5]) * 1e-6

    def inertia(stiffer: float, turn: np.ndarray) -> engine.EvenInertia | engine.TensorInertia:
        if kind == "one moment":
            return engine.EvenInertia(mass, moments[1] + stiffer)
        turned = matrix_from_quat(quat_from_rotvec(turn)) @ attitude
        return engine.TensorInertia(mass, turned @ np.diag(1.0 / (moments + stiffer)) @ turned.T)

    def impulse(x: np.ndarray) -> np.ndarray:
        now = inertia(x[8], x[9:])
        matrix = (
            engine.spherical_contact_matrix(mass, now.moment, *x[:3])
            if isinstance(now, engine.EvenInertia)
            else engine.contact_matrix(mass, now.inverse, *x[:3])
        )
        return np.array(engine.friction_impulse(matrix, x[6], x[7], engine.STRONGE, *x[3:6]))

    inputs = derivatives.INPUTS if kind == "one moment" else derivatives.ASYMMETRIC_INPUTS
    gradient, changes = np.empty((3, inputs)), np.empty((inputs - derivatives.INPUTS + derivatives.MATRIX_CHANGES, 6))
    found = derivatives.impulse_gradient(law, inertia(0.0, np.zeros(3)), arm, contact, (True, True), changes, gradient)
    given = np.array([*arm, *contact, chi, mu, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found, impulse(given), rtol=1e-12)
    sizes = np.array([*np.abs(arm), *np.abs(contact), 1.0, 1.0, moments[1], 1.0, 1.0, 1.0])
    for k in range(9 if kind == "one moment" else 12):
        step = np.eye(12)[k] * 1e-3 * sizes[k]
        if k in (6, 7) and given[k] == 0.0:
            ahead = [impulse(given + n * step) for n in range(5)]
            slope = sum(w * s for w, s in zip((-25, 48, -36, 16, -3), ahead, strict=True)) / 12.0
        else:
            near, far = (impulse(given + n * step) - impulse(given - n * step) for n in (1, 2))
            slope = (8 * near - far) / 12.0
        # Fourth order at steps of a thousandth, second order at 1e-5: some 1e-9 each. Rounding over the latter is 1e-10 at most.
        expected = slope / step[k]
        rounding = 1e-13 if kind == "one moment" else 1e-10 * np.abs(found).max() / sizes[k]
        column = gradient[:, k if k < 9 else derivatives.INPUTS + k - 9]
        np.testing.assert_allclose(column, expected, atol=1e-7 * np.abs(expected).max() + rounding)


def test_parameters_that_do_not_act_have_columns_of_zeros():
    names = tuple(name for name in PARAMETERS if name not in OF_CENTRE)
    model = (make_die("cube", 0.02, 0.016), LAWS["smooth"], LEVEL, 0.0)
    start, vertices, times = a_throw(model, 7, 3)
    moved = np.abs(run(model, start, times, vertices, names).jacobian).max(axis=(0, 1))[12:]
    of_nothing = {"mu", "speed_scale_m_s", "table_amplitude_m", "table_frequency_hz", "table_phase_rad"}
    assert {name for name, size in zip(names, moved, strict=True) if size == 0.0} == of_nothing
    # Before the first impact nothing but the air acts, and the start stays where it is.
    early = run(model, start, np.array([start.time_s, start.time_s + 0.01]), vertices, names).jacobian
    acts = np.abs(early[:, :, 12:]).max(axis=(0, 1)) > 1e-15
    assert {name for name, does in zip(names, acts, strict=True) if does} == {"drag_per_m"}
    skewed = run((TOPS["loaded"], *model[1:]), start, times, vertices, ("inertia_kg_m2",))
    assert not skewed.jacobian[:, :, 12].any()


def test_poses_are_nan_behind_an_impact_that_leaves_no_velocity_that_a_throw_can_have():
    """Back in time, to where a vertex below the table crossed it, the speed in thick air grows beyond all bounds."""
    below = State(
        0.0, np.array([0, 0, -0.06]), np.array([1.0, 0, 0, 0]), np.array([0, 0, -3.0]), np.array([3.0, 2.0, 1.0])
    )
    found = propagate(
        make_die("cube", 0.02, 0.016), below, SmoothImpact(0.5), [-0.01, 0.02], vertices=[0, 1, 2, 3], drag_per_m=300.0
    )
    assert len(found.impact_times_s) == 1
    assert np.isnan(found.positions_m[1]).all()
    assert np.isnan(found.jacobian[1]).all()


def test_a_vertex_that_hardly_ceases_to_rise_below_the_table_ends_the_search_for_its_touch():
    """A trial step of a fit: vertex 9 is below the table when its turn comes, rises to an inflection, and sinks for good."""
    packed = [
        0.017843656595865037, -0.03652084542700745, 0.023112383103382372, 0.42871549617622845, -0.8410279174863964,
        -0.294611261065033, 0.14859094925511748, -0.26995429647441027, 0.40900747118324926, -0.09962139002876111,
        5.127365913843905, 26.689017204606383, -8.922414455923015,
    ]  # fmt: skip
    start, die = unpacked_state(np.array(packed), 0.0), make_die("dodecahedron", 0.00698, 0.004)
    law, names = CoulombImpact(0.8935502990564312, 0.1920394329343423, "algebraic"), ("chi", "mu", "drag_per_m")
    found = propagate(die, start, law, [0.03], vertices=[19, 18, 12, 17, 11, 11, 11, 9], parameters=names)
    assert len(found.impact_times_s) == 7


def test_unknown_parameters_and_negative_drag_raise_and_name_the_value():
    model = (ROUNDED["cube"], LAWS["smooth"], LEVEL, 0.0)
    start, vertices, times = a_throw(model, 7, 1)
    with pytest.raises(ValueError, match=r"parameters = \['colour'\]: wanted each once, of chi, mu"):
        run(model, start, times, vertices, ("colour",))
    with pytest.raises(ValueError, match=r"parameters = \['chi', 'chi'\]"):
        run(model, start, times, vertices, ("chi", "chi"))
    with pytest.raises(ValueError, match=r"drag_per_m = -1\.0"):
        run((*model[:3], -1.0), start, times, vertices)
    fading = FrictionBySpeed(LAWS["rough by speed"], 2.0)
    with pytest.raises(ValueError, match="a friction by speed on a die with several moments of inertia"):
        run((TOPS["loaded"], fading, LEVEL, 0.0), start, times, vertices)
    with pytest.raises(ValueError, match="air drag on a die with several moments of inertia"):
        run((TOPS["loaded"], LAWS["smooth"], LEVEL, 0.1), start, times, vertices)
