"""The filmed samples agree with their throw files, and are small enough to clone."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from diethrow.commands.clip.footage import open_footage
from diethrow.files.plan import read_plan
from diethrow.files.scene import read_scene
from diethrow.model.rotations import matrix_from_quat
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.footage.background import load_background

ROOT = Path(__file__).parents[3]
SAMPLES = ("cube_mirror", "icosahedron_cork", "tetrahedron_wood")


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name].split()[0]) for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("name", SAMPLES)
def test_the_film_changes_where_the_true_die_is_projected(name: str) -> None:
    scene = read_scene(ROOT / "data_samples" / name / "scene.toml")
    clip = open_footage(scene, scene.views()[0])
    background = load_background(ROOT / "data_samples" / name / "background.png", clip)
    truth = columns(ROOT / "tests" / "data" / name / "truth.csv")
    assert len(clip) == len(truth["frame"])
    camera, corners = scene.cameras[0].camera, scene.die.solid.vertices
    for k in np.flatnonzero(truth["fully_visible"])[::40]:
        rotation = matrix_from_quat([truth[q][k] for q in ("qw", "qx", "qy", "qz")])
        seen = camera.project(corners @ rotation.T + [truth[axis][k] for axis in "xyz"])
        hull = cv2.convexHull(seen.astype(np.float32))[:, 0].round().astype(np.int32)
        die, near = (np.zeros(background.shape, np.uint8) for _ in range(2))
        cv2.fillConvexPoly(die, hull, 1)
        near = cv2.dilate(die, np.ones((17, 17), np.uint8)) - cv2.dilate(die, np.ones((5, 5), np.uint8))
        change = np.abs(clip.frame(int(k)).astype(float) - background)
        # Round the die there may be its shadow or its mirror image, which change the median of the ring by less.
        assert np.median(change[die > 0]) > 2.0 * np.median(change[near > 0])


@pytest.mark.parametrize("name", SAMPLES)
def test_the_bounces_are_those_of_the_throw_file(name: str) -> None:
    plan = read_plan(ROOT / "data_samples" / "throws" / f"{name}.toml")
    folder = ROOT / "tests" / "data" / name
    bounces = columns(folder / "bounces.csv")
    law = tomllib.loads((folder / "truth.toml").read_text())["truth"]
    assert (law["chi"], law["mu"]) == (plan.chi, plan.mu)
    # The first three only: in a chattering die rounding grows with every bounce.
    impacts = throw_die(plan.die, plan.release, plan.law, until=Until(impacts=3)).throw.bounces
    apart = np.array([impact.time_s for impact in impacts]) - bounces["t"][:3]
    assert np.ptp(apart) < 1e-7  # the film leaves out the first part of the fall
    assert bounces["vn_pre"][:3] == pytest.approx([i.normal_velocity_before_m_s for i in impacts], rel=1e-6)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_filmed_sample_is_small(name: str) -> None:
    assert sum(file.stat().st_size for file in (ROOT / "data_samples" / name).glob("*")) <= 3_000_000
