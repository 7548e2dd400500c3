"""A filmed throw is a clip that the rest of the program accepts; impossible films are refused in one sentence."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import CUBE, LAW, RELEASE, SMALL_CAMERA, invoke, text_file
from film_studio import with_mitsuba

from diethrow.commands.clip.footage import open_footage
from diethrow.commands.model.film_settings import FilmSettings
from diethrow.commands.model.film_truth import visibility
from diethrow.commands.model.filmed_throw import camera_for, film_job, recorded, scene_text
from diethrow.files.plan import read_plan
from diethrow.files.scene import read_scene
from diethrow.tracking.footage.background import load_background
from diethrow.tracking.footage.response import light_table

DIE = f'[table]\nsurface = "cork"\n{CUBE}'
LOW_RELEASE = RELEASE.replace("0.06]", "0.03]").replace("[0.3,", "[0.1,")
THROW = f"{LAW}{LOW_RELEASE}[until]\nimpacts = 2\n"
CAMERA = f"[clip]\nfps = 1000.0\nexposure_s = 0.0003\n{SMALL_CAMERA}"


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return text_file(tmp_path / "throw.toml", DIE + THROW)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return text_file(tmp_path / "scene.toml", CAMERA + DIE + 'marks = "pips"\n')


@with_mitsuba
def test_a_film_is_a_clip_with_its_truth(plan: Path, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "film"
    words = ("film", plan, "--scene", scene, "--out", out, "--frames", 4, "--samples", 2, "--bits", 12, "--threads", 1)
    assert invoke(*words)[0] == 0
    filmed, given = read_scene(out / "scene.toml"), read_scene(scene)
    assert filmed.die.marks == "pips"
    assert filmed.table.surface == "cork"
    assert (filmed.clip.fps, filmed.clip.exposure_s) == (1000.0, 0.0003)
    assert (filmed.cameras[0].camera.matrix == given.cameras[0].camera.matrix).all()
    clip = open_footage(filmed, filmed.views()[0])
    assert (len(clip), clip.bit_depth) == (4, 12)
    background = load_background(out / "background.png", clip)
    frame = clip.frame(3).astype(float)
    assert 200 < background.mean() < 3000
    # Where the die is, the frame differs from the empty table by more than its noise, which is below 40 of 4095.
    assert np.abs(frame - background).max() > 400
    with (out / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    throw = film_job(read_plan(plan), given, FilmSettings(frames=4), "film").throw
    for row in rows:
        state = throw.at(float(row["t"]))
        assert [float(row[name]) for name in "xyz"] == pytest.approx(state.position_m, abs=1e-12)
    assert json.loads((out / "provenance.json").read_text())["seeds"] == {"film": 1}
    assert invoke(*words)[0] == 2


def test_without_mitsuba_the_error_says_what_to_install(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    status, _, expected = invoke("film", plan, "--out", tmp_path / "film", "--frames", 2)
    assert status == 1
    assert "pip install 'diethrow[film]'" in expected
    assert not (tmp_path / "film").exists()


def test_a_camera_without_a_scene_keeps_the_throw_in_view(plan: Path) -> None:
    job = film_job(read_plan(plan), None, FilmSettings(), "film")
    times = np.arange(job.frames) / job.fps
    camera = camera_for(job.throw, job.die, times)
    positions = job.throw.poses(times)[0]
    rotations = np.array([job.throw.at(float(t)).rotation for t in times])
    wholly, _ = visibility(job.die, camera, positions, rotations)
    first = job.throw.impacts[0].time_s
    assert wholly[times >= first].all()
    # Nor from so far that nothing can be measured: the die is at least a twentieth of the picture.
    assert job.die.solid.edge_m * camera.matrix[0, 0] / camera.translation_m[2] > camera.width_px / 20


@pytest.mark.parametrize("response", ["srgb", 0.45])
def test_a_film_with_a_response_names_it_and_is_undone_by_it(plan: Path, scene: Path, response: str | float) -> None:
    job = film_job(read_plan(plan), None, FilmSettings(response=response, bit_depth=12), "film")
    stated = json.dumps(response)
    assert f"response = {stated}\n" in scene_text(job, "clip.avi")
    levels = np.linspace(-20.0, 4200.0, 500).reshape(2, 250)
    seen = light_table(12, response)[recorded(job, levels)] / (2.0**16 - 1.0)
    # Half a grey level where the curves are steepest: an eighth per cent.
    np.testing.assert_allclose(seen, np.clip(levels / 4095.0, 0.0, 1.0), atol=4e-4)
    # The response of a scene is that of its camera; without one a film is linear and its scene does not mention it.
    scene.write_text(scene.read_text().replace("fps =", f"response = {stated}\nfps ="))
    assert film_job(read_plan(plan), read_scene(scene), FilmSettings(), "film").response == response
    linear = film_job(read_plan(plan), None, FilmSettings(), "film")
    assert "response" not in scene_text(linear, "clip.avi")


def test_a_film_on_the_moon_says_so(plan: Path, tmp_path: Path) -> None:
    plan.write_text(f"{plan.read_text()}\n[world]\ngravity_m_s2 = 1.62\n")
    job = film_job(read_plan(plan), None, FilmSettings(start_s=0.01), "film")
    assert {flight.gravity_m_s2 for flight in job.throw.flights} == {1.62}
    (tmp_path / "clip.avi").touch()
    (tmp_path / "background.png").touch()
    filmed = read_scene(text_file(tmp_path / "scene.toml", scene_text(job, "clip.avi")))
    assert filmed.table.in_model.gravity_m_s2 == 1.62


def test_a_later_start_gives_the_same_throw_with_time_zero_there(plan: Path) -> None:
    whole, late = (film_job(read_plan(plan), None, FilmSettings(start_s=s), "film").throw for s in (0.0, 0.01))
    for t in (0.0, 0.02, 0.05):
        assert late.at(t).position_m == pytest.approx(whole.at(t + 0.01).position_m, abs=1e-9)
    # The impacts multiply rounding by a few units.
    assert late.impacts[1].time_s + 0.01 == pytest.approx(whole.impacts[1].time_s, abs=1e-9)


def test_a_film_until_rest_shows_the_die_at_rest(plan: Path) -> None:
    plan.write_text(plan.read_text().replace("impacts = 2", "").replace("[until]", ""))
    job = film_job(read_plan(plan), None, FilmSettings(), "film")
    end = job.throw.at((job.frames - 1) / job.fps)
    lowest = float((job.die.solid.vertices @ end.rotation.T + end.position_m)[:, 2].min())
    assert lowest > -1e-6


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("--bits", 9), "bit_depth = 9: wanted one of 8, 10, 12, 16"),
        (("--noise", -1), "noise = -1.0: wanted a factor, 0 or more"),
        (("--frames", 0), "frames = 0: wanted 1 to 100000"),
        (("--size", 5), "size_px = 5: wanted 16 to 8192"),
        (("--start", 0.5), "start_s = 0.5: wanted a time before the first impact at"),
        (("--fps", 0), "fps = 0.0: wanted a finite number above 0"),
        (("--response", 2.2), "response = 2.2: wanted one of linear, srgb, or an exponent from 0.2 to 1.5"),
        (("--response", "gamma"), "response = 'gamma': wanted one of linear, srgb"),
        (("--exposure", 1), "exposure_s = 1.0: wanted at most the 0.0006667 s between two frames"),
    ],
)
def test_impossible_options_are_refused_by_name(
    plan: Path, tmp_path: Path, words: tuple[object, ...], wanted: str
) -> None:
    status, _, error = invoke("film", plan, "--out", tmp_path / "film", *words)
    assert status in (1, 2)
    assert wanted in error


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("[camera]", "[[camera]]", ""), ""),
        (("cube", "octahedron", "die"), 'die.shape = "octahedron"'),
    ],
)
def test_a_scene_with_another_die_is_refused(
    plan: Path, scene: Path, tmp_path: Path, change: tuple[str, str, str], expected: str
) -> None:
    scene.write_text(scene.read_text().replace(change[0], change[1]).replace('marks = "pips"\n', ""))
    if not expected:
        assert film_job(read_plan(plan), read_scene(scene), FilmSettings(), "film").camera.width_px == 96
        return
    status, _, error = invoke("film", plan, "--scene", scene, "--out", tmp_path / "film")
    assert status == 2
    assert expected in error


def test_a_table_that_moves_is_refused(plan: Path, tmp_path: Path) -> None:
    motion = 'surface = "cork"\nmotion = {amplitude_m = 0.001, frequency_hz = 20.0}'
    plan.write_text(plan.read_text().replace('surface = "cork"', motion))
    status, _, error = invoke("film", plan, "--out", tmp_path / "film")
    assert status == 2
    assert "table.motion.amplitude_m = 0.001" in error
