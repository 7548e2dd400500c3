"""Impossible input of the model: each error names the quantity and the value."""

from dataclasses import replace

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model.die.die import loaded_die, make_die
from diethrow.model.die.solid import isohedral_solid
from diethrow.model.laws import CoulombImpact, RestitutionBySpeed, SmoothImpact, Table
from diethrow.model.throw.simulate import Precision, Until, throw_die

STILL = np.zeros(3)
DICE_BY_NAME = {
    "cube": DICE["cube"],
    "rounded cube": make_die("cube", 0.02, 0.016, corner_radius_m=0.0025),
    "loaded cube": loaded_die(isohedral_solid("cube", 0.02), 0.012, 0.004, [0.002, 0.005, -0.003]),
}


# ---- impossible input -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Table(tilt_rad=np.nan), "tilt_rad = nan"),
        (lambda: Table(phase_rad=np.inf), "phase_rad = inf"),
        (lambda: Table(frequency_hz=-np.inf), "frequency_hz = -inf"),
        (lambda: Table(tilt_rad=1.6), r"tilt_rad = 1\.6: .* 1\.5"),
        (lambda: Table(amplitude_m=-1e-3, frequency_hz=5.0), r"amplitude_m = -0\.001"),
        (lambda: Until(time_s=np.nan), "time_s = nan"),
        (lambda: Until(impacts=-1), "impacts = -1"),
        (lambda: Precision(contact_tolerance_m=-1e-12), "contact_tolerance_m = -1e-12"),
        (lambda: Precision(slowest_bounce=np.nan), "slowest_bounce = nan"),
        (lambda: Precision(step_turn_rad=0.0), r"step_turn_rad = 0\.0"),
        (lambda: SmoothImpact(np.nan), "chi = nan"),
        (lambda: SmoothImpact(-1e-9), "chi = -1e-09"),
        (lambda: CoulombImpact(0.5, np.nan), "mu = nan"),
        (lambda: CoulombImpact(0.5, 0.1, "plastic"), "restitution = 'plastic'"),
        (lambda: RestitutionBySpeed(SmoothImpact(0.5), np.inf), "speed_scale_m_s = inf"),
        (lambda: RestitutionBySpeed(SmoothImpact(0.5), 1.0, np.nan), "exponent = nan"),
        (lambda: Until(impacts=np.nan), "impacts = nan"),
        (lambda: Until(impacts=2.5), r"impacts = 2\.5"),
        (lambda: RestitutionBySpeed(RestitutionBySpeed(SmoothImpact(0.5), 1.0), 1.0), "law = RestitutionBySpeed"),
        (lambda: make_die("ball", 0.02, 0.016), "shape = 'ball': .*tetrahedron"),
        (lambda: make_die("cube", -0.02, 0.016), r"edge_m = -0\.02"),
        (lambda: make_die("cube", np.inf, 0.016), "edge_m = inf"),
        (lambda: make_die("cube", 0.02, 0.0), r"mass_kg = 0\.0"),
        (lambda: make_die("cube", 0.02, 0.016, inertia_kg_m2=np.nan), "inertia_kg_m2 = nan"),
        (lambda: make_die("cube", 0.02, 0.016, corner_radius_m=np.nan), "corner_radius_m = nan"),
        (lambda: loaded_die(isohedral_solid("cube", 0.02), 0.016, np.nan, STILL), "load_kg = nan"),
        # A body inside the die's sphere has no more than 2/3 m R² about every axis.
        (lambda: make_die("cube", 0.02, 0.016, corner_radius_m=0.0099), r"corner_radius_m = 0\.0099.* 0\.95"),
        (lambda: make_die("cube", 0.02, 0.016, inertia_kg_m2=1e9), r"inertia_kg_m2 = 1000000000\.0"),
    ],
)
def test_impossible_values_raise_with_their_name_and_value(make, named):
    with pytest.raises(ValueError, match=named):
        make()


@pytest.mark.parametrize("die", DICE_BY_NAME.values(), ids=DICE_BY_NAME)
@pytest.mark.parametrize("table", [Table(), Table(tilt_rad=0.1)], ids=["level", "tilted"])
@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("position_m", [0.0, np.nan, 0.1], "position_m"),
        ("position_m", [0.0, 0.0, -1.0], "position_m = .*below the table"),
        ("quaternion", [0.5, 0.5, 0.5, 0.6], r"quaternion of length 1\.05"),
        ("quaternion", [0.0, 0.0, 0.0, 0.0], "quaternion of length 0"),
        ("velocity_m_s", [np.inf, 0.0, 0.0], "velocity_m_s"),
        ("omega_rad_s", [0.0, 0.0, np.nan], "omega_rad_s"),
        ("time_s", np.nan, "time_s = nan"),
        ("time_s", 2.0, r"until time_s = 1\.0: .* 2\.0 s"),
    ],
)
def test_an_impossible_release_raises_on_every_table(die, table, field, value, named):
    good = replace(random_release(np.random.default_rng(103), die, clearance_m=0.3), time_s=0.0)
    bad = replace(good, **{field: value if field == "time_s" else np.array(value)})
    with pytest.raises(ValueError, match=named):
        throw_die(die, bad, SmoothImpact(0.5), table=table, until=Until(time_s=1.0))


@pytest.mark.parametrize(
    ("field", "value"),
    [("velocity_m_s", [0.0, 0.0, -1e100]), ("velocity_m_s", [1e300, 0.0, 0.0])],
)
def test_a_velocity_beyond_double_precision_raises_with_its_name(field, value):
    die = DICE["cube"]
    good = random_release(np.random.default_rng(103), die, clearance_m=0.3)
    with pytest.raises(ValueError, match=field):
        throw_die(die, replace(good, **{field: np.array(value)}), SmoothImpact(0.5))


def test_a_table_so_fast_that_its_phase_is_lost_raises():
    die = DICE["cube"]
    release = random_release(np.random.default_rng(5), die)
    with pytest.raises(ValueError, match="frequency_hz"):
        throw_die(
            die, release, SmoothImpact(0.5), table=Table(amplitude_m=1e-6, frequency_hz=1e12), until=Until(impacts=3)
        )
