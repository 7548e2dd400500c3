"""A die of any convex shape, from its throw file to the fit: filmed, tracked by its contour, its restitution estimated.

The pictures are drawn with one grey level a face, as in `footage_of_throws`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
import trimesh
from footage_files import write_video
from footage_of_throws import FPS, film, studio
from random_throws import random_quaternion

from diethrow.commands.clip.analyze import analyze
from diethrow.files.analysis_folder import AnalysedThrow
from diethrow.files.scene import read_scene
from diethrow.model.die import Die, die_from_solid, symmetry_rotations
from diethrow.model.laws import CoulombImpact, SmoothImpact
from diethrow.model.rotations import angle_between, quat_from_matrix, quat_multiply
from diethrow.model.throw import State, Throw, Until, throw_die

CHI = 0.55
ROOM = replace(studio(260, 260), noise_grey=2.0)
DICE = {
    "cuboid": 'shape = "cuboid"\nedges_m = [0.011, 0.0132, 0.0165]\n',
    "d10": 'shape = "d10"\nedge_m = 0.0125\nshort_edge_m = 0.0068\n',
    "wedge": 'shape = "wedge.stl"\nunit_m = 0.001\n',
}
"""`[die]` tables without a mass. The wedge is a prism on a triangle of three different sides, with no symmetry but one plane."""
SEEDS = {"cuboid": 2, "d10": 3, "wedge": 5}
FRICTION = {"cuboid": 0.2}
"""Of the table that each is thrown on; on the others it is smooth."""
DURATION_S = 0.12


def written_scene(folder: Path, kind: str) -> Path:
    """The scene of a clip `clip.mkv`, and the mesh that it names."""
    triangle = np.array([[0.0, 0.0], [17.0, 0.0], [5.0, 12.0]])
    mesh = trimesh.creation.extrude_triangulation(triangle, np.array([[0, 1, 2]]), 14.0)
    mesh.export(folder / "wedge.stl")
    camera = ROOM.camera
    scene = folder / "scene.toml"
    scene.write_text(
        f"""[clip]
path = "clip.mkv"
fps = {FPS}
fps_sigma = 0.0
response = "linear"
[camera]
width = {camera.width_px}
height = {camera.height_px}
matrix = {camera.matrix.tolist()}
distortion = {camera.distortion.tolist()}
rotation = {camera.rotation.tolist()}
translation_m = {camera.translation_m.tolist()}
calibration = "exact"
[table]
surface = "wood"
[die]
{DICE[kind]}edge_sigma_m = 0.0
mass_kg = 0.004
corner_radius_m = 0.0
"""
    )
    return scene


def thrown(die: Die, seed: int, mu: float | None) -> Throw:
    """A throw with two bounces that stays in view."""
    rng = np.random.default_rng(seed)
    release = State(
        0.0,
        np.array([-0.004, 0.0, 0.030]),
        random_quaternion(rng),
        np.array([0.08, 0.03, -0.5]),
        20.0 * rng.normal(size=3),
    )
    law = SmoothImpact(CHI) if mu is None else CoulombImpact(CHI, mu)
    return throw_die(die, release, law, until=Until(time_s=DURATION_S)).throw


@cache
def analysed(kind: str) -> tuple[Die, Throw, AnalysedThrow]:
    folder = Path(mkdtemp())
    scene = written_scene(folder, kind)
    (folder / "clip.mkv").touch()
    die = read_scene(scene).die
    throw = thrown(die, SEEDS[kind], FRICTION.get(kind))
    clip = film(ROOM, die, throw, int(DURATION_S * FPS))
    write_video(folder / "clip.mkv", np.array([clip.frame(k) for k in range(len(clip))]), fps=int(FPS), codec="ffv1")
    return die, throw, analyze(read_scene(scene), folder / "out")


@pytest.mark.parametrize("kind", DICE)
def test_a_die_of_any_shape_is_tracked_and_its_throw_fitted(kind: str) -> None:
    die, throw, found = analysed(kind)
    track = found.track
    assert track.tracked.all()
    positions, quaternions = throw.poses(track.time_s)
    # Faces that a symmetry exchanges look alike: one labelling for the whole clip.
    turns = quat_from_matrix(symmetry_rotations(die.solid))
    angles = [angle_between(track.quaternion, quat_multiply(quaternions, turn)) for turn in turns]
    assert min(float(angle.max()) for angle in angles) < np.radians(0.5)
    assert np.linalg.norm(track.position_m - positions, axis=1).max() < 5e-4
    chi = found.result.parameters["chi"]
    assert abs(chi.value - CHI) < 0.01
    assert chi.low < CHI < chi.high
    assert found.result.bounces_fitted == len(throw.bounces)
    if kind not in FRICTION:
        assert found.result.chosen == ("smooth impact",)
        return
    mu = found.result.parameters["mu"]
    assert mu.low < FRICTION[kind] < mu.high
    assert abs(mu.value - FRICTION[kind]) < 0.05
    assert found.result.landed_face is not None or sum(found.result.face_odds.values()) == pytest.approx(1.0)


def test_a_die_with_several_moments_does_not_turn_evenly() -> None:
    """Otherwise the test above would pass with a law of flight that is too simple."""
    for kind in DICE:
        die = analysed(kind)[0]
        moments = np.linalg.eigvalsh(die_from_solid(die.solid, 1.0).tensor_kg_m2)
        assert np.ptp(moments) > 0.1 * moments[0]
