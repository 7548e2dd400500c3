"""The throw file: one release, in the paper's angles or as a quaternion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import text_file

from diethrow.files.plan import read_plan
from diethrow.files.settings import SceneError
from diethrow.model.laws import CoulombImpact, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_euler

PLAN = """\
[die]
shape = "cube"
edge_m = 0.02
mass_kg = 0.016

[table]
surface = "wood"

[law]
chi = 0.5

[initial]
position_m = [0.0, 0.0, 0.3]
euler_rad = [0.1, 1.2, -0.4]
velocity_m_s = [0.6, 0.0, -0.7]
omega_body_rad_s = [0.0, 60.0, 0.0]

[until]
impacts = 8
"""

MISTAKES = {
    "chi above 1": ("chi = 0.5", "chi = 1.5", ["law.chi = 1.5", "from 0 to 1"]),
    "air that pushes": ("[until]", "[world]\ndrag_per_m = -0.1\n\n[until]", ["world.drag_per_m = -0.1", "0 to 1000"]),
    "friction that pushes": ("chi = 0.5", "chi = 0.5\nmu = -0.2", ["law.mu = -0.2", "0 or more"]),
    "below a table that stands high": (
        'surface = "wood"',
        'surface = "wood"\nmotion = {amplitude_m = 0.5, frequency_hz = 2.0, phase_rad = 1.5}',
        ["initial.position_m", "below the table"],
    ),
    "degrees": ("[0.1, 1.2, -0.4]", "[10.0, 68.0, -23.0]", ["initial.euler_rad", "radians"]),
    "millimetres": ("[0.0, 0.0, 0.3]", "[0.0, 0.0, 300.0]", ["initial.position_m", "metres", "0.3"]),
    "below the table": ("[0.0, 0.0, 0.3]", "[0.0, 0.0, 0.001]", ["initial.position_m", "below the table"]),
    "two numbers for three": ("[0.6, 0.0, -0.7]", "[0.6, 0.0]", ["initial.velocity_m_s", "3 numbers"]),
    "no orientation": ("euler_rad = [0.1, 1.2, -0.4]\n", "", ["initial.euler_rad", "quaternion_wxyz", "neither"]),
    "two orientations": ("[0.1, 1.2, -0.4]", "[0, 0, 0]\nquaternion_wxyz = [1, 0, 0, 0]", ["both", "one of the two"]),
    "long quaternion": ("euler_rad = [0.1, 1.2, -0.4]", "quaternion_wxyz = [1, 1, 0, 0]", ["unit", "length 1.41421"]),
    "no spin": ("omega_body_rad_s = [0.0, 60.0, 0.0]\n", "", ["initial.omega_rad_s", "neither"]),
    "corners of pictures": (
        "edge_m =",
        'corner_radius_m = "estimate"\nedge_m =',
        ["die.corner_radius_m", "no pictures"],
    ),
    "no impacts": ("impacts = 8", "impacts = 0", ["until.impacts = 0", "above 0"]),
    "unknown key": ("impacts = 8", "impact = 8", ["until.impact", "did you mean impacts?"]),
}


def plan_file(folder: Path, text: str = PLAN) -> Path:
    return text_file(folder / "throw.toml", text)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_every_mistake_is_one_sentence_that_names_file_key_and_value(tmp_path: Path, mistake: str) -> None:
    old, new, facts = MISTAKES[mistake]
    assert old in PLAN
    path = plan_file(tmp_path, PLAN.replace(old, new))
    with pytest.raises(SceneError) as caught:
        read_plan(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    for words in facts:
        assert words in str(caught.value)


def test_the_papers_angles_and_body_spin_mean_the_same_as_a_quaternion_and_world_spin(tmp_path: Path) -> None:
    paper = read_plan(plan_file(tmp_path)).release
    q = quat_from_euler([0.1, 1.2, -0.4])
    omega = matrix_from_quat(q) @ [0.0, 60.0, 0.0]
    ours = PLAN.replace("euler_rad = [0.1, 1.2, -0.4]", f"quaternion_wxyz = {q.tolist()}")
    ours = ours.replace("omega_body_rad_s = [0.0, 60.0, 0.0]", f"omega_rad_s = {omega.tolist()}")
    release = read_plan(plan_file(tmp_path, ours)).release
    np.testing.assert_allclose(release.quaternion, paper.quaternion, atol=1e-15)
    np.testing.assert_allclose(release.omega_rad_s, paper.omega_rad_s, atol=1e-13)


def test_the_table_of_a_throw_may_be_left_out(tmp_path: Path) -> None:
    plan = read_plan(plan_file(tmp_path, PLAN.replace('[table]\nsurface = "wood"\n', "")))
    assert (plan.chi, plan.until_impacts, plan.until_s, plan.fps) == (0.5, 8, None, 1500.0)


def test_friction_air_and_an_oscillating_table_reach_the_model_only_where_they_are_given(
    tmp_path: Path,
) -> None:
    assert read_plan(plan_file(tmp_path)).law == SmoothImpact(0.5)
    assert read_plan(plan_file(tmp_path)).model_table == Table()
    rough = PLAN.replace("chi = 0.5", "chi = 0.5\nmu = 0.2")
    assert read_plan(plan_file(tmp_path, rough)).law == CoulombImpact(0.5, 0.2)
    dragged = PLAN.replace("[until]", "[world]\ndrag_per_m = 0.03\n\n[until]")
    assert (read_plan(plan_file(tmp_path)).drag_per_m, read_plan(plan_file(tmp_path, dragged)).drag_per_m) == (
        0.0,
        0.03,
    )
    shaken = PLAN.replace('"wood"', '"wood"\nmotion = {amplitude_m = 0.001, frequency_hz = 25.0, phase_rad = 0.5}')
    assert read_plan(plan_file(tmp_path, shaken)).model_table == Table(
        amplitude_m=0.001, frequency_hz=25.0, phase_rad=0.5
    )
