"""`diethrow fit` with several tracks, and `diethrow predict`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import CUBE_ON_WOOD, invoke
from throws import random_release, seen

from diethrow.files.throw_records import read_simulated, write_track
from diethrow.fitting.throw.physics import Physics
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL, Table
from diethrow.model.throw.simulate import Until

CUBE = make_die("cube", 0.016, 0.0048)


@pytest.fixture(scope="module")
def throws(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, three tracks of one smooth law, a track without a bounce, and one whose times do not rise."""
    folder = tmp_path_factory.mktemp("throws")
    (folder / "scene.toml").write_text(f"[clip]\nfps = 1500.0\n{CUBE_ON_WOOD}")
    rng = np.random.default_rng(2)
    for k in range(3):
        throw = Physics(CUBE, LEVEL, {"chi": 0.6}).throw(random_release(CUBE, rng), Until(time_s=0.13)).throw
        track = seen(throw, rng, noise=0.05)
        write_track(folder / f"throw_{k}.csv", track)
    lines = (folder / "throw_0.csv").read_text().splitlines(keepends=True)
    (folder / "falling.csv").write_text("".join(lines[:12]))
    (folder / "backwards.csv").write_text("".join([*lines[:40], *lines[20:60]]))
    return folder


@pytest.fixture(scope="module")
def fitted(throws: Path) -> Path:
    tracks = [throws / f"{name}.csv" for name in ("throw_0", "throw_1", "throw_2", "falling", "backwards")]
    status, _, notes = invoke(
        "fit", *tracks, "--scene", throws / "scene.toml", "--out", throws / "joint", "--threads", 2
    )
    assert status == 0, notes
    assert "falling.csv is left out" in notes
    assert "backwards.csv is left out: t_s" in notes
    return throws / "joint" / "fit.json"


def test_several_tracks_share_their_parameters(fitted: Path) -> None:
    fit = json.loads(fitted.read_text())
    assert fit["parameters"]["chi"]["value"] == pytest.approx(0.6, abs=0.01)
    assert [throw["track"] for throw in fit["throws"]] == ["throw_0", "throw_1", "throw_2"]
    assert fit["law"]["friction"] == "none"
    assert len(fit["left_out"]) == 2
    assert fit["minima"][0]["parameters"]["chi"] == fit["parameters"]["chi"]["value"]
    assert fit["covariance"]["names"] == ["chi"]
    assert 0.0 < fit["covariance"]["matrix"][0][0] < 0.02**2
    assert len(fit["misfit"]["t_s"]) == len(fit["misfit"]["position_m"]) == len(fit["misfit"]["rotation_rad"])
    assert (fitted.parent / "vertices.csv").exists()
    assert (fitted.parent / "provenance.json").exists()


def test_a_prediction_has_one_row_per_row_of_its_track(throws: Path, fitted: Path) -> None:
    out = throws / "one.csv"
    wanted = ("--scene", throws / "scene.toml", "--fit", fitted, "--from-frame", "first-bounce", "--out", out)
    status, output, notes = invoke("predict", throws / "throw_0.csv", *wanted, "--draws", 10)
    assert status == 0, notes
    assert "after bounces" in output
    predicted, beside = read_simulated(out), json.loads(out.with_suffix(".json").read_text())
    assert len(predicted) == 196
    covariances = np.load(out.with_name("one_covariance.npy"))
    assert covariances.shape == (196, 6, 6)
    simulated = predicted.tracked & (predicted.time_s > beside["state"]["t_s"])
    assert (np.linalg.eigvalsh(covariances[simulated])[:, -1] > 0.0).all()
    assert np.isnan(covariances[~simulated]).all()
    assert "throw_0.csv" in {Path(each["path"]).name for each in beside["provenance"]["inputs"]}
    assert beside["frames_used"] >= 3
    assert set(beside["decided"]) == {"face", "bounces", "t_s"}
    status, _, notes = invoke("predict", throws / "throw_0.csv", *wanted)
    assert status == 2
    assert "exists" in notes


def test_predictions_of_several_tracks_fill_a_folder(throws: Path, fitted: Path) -> None:
    tracks = [throws / f"{name}.csv" for name in ("throw_1", "throw_2", "falling")]
    out = throws / "predicted"
    status, output, notes = invoke("predict", *tracks, "--scene", throws / "scene.toml", "--fit", fitted, "--out", out)
    assert status == 0, notes
    assert "2 throws predicted" in output
    assert "falling.csv is left out" in notes
    kinds = (".csv", ".json", "_covariance.npy")
    files = {f"throw_{k}{kind}" for k in (1, 2) for kind in kinds} | {"provenance.json"}
    assert {path.name for path in out.iterdir()} == files
    origin = json.loads((out / "provenance.json").read_text())
    read = {Path(each["path"]).name for each in origin["inputs"]}
    assert read >= {"scene.toml", "fit.json", "throw_1.csv", "throw_2.csv"}
    status, said, notes = invoke("rerun", out)
    assert status == 0, said + notes
    assert "agree bit for bit, in all 6 files" in said


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"parameters": {"chi": None}}, "not a fit"),
        ({"parameters": {"bounciness": {"value": 0.5}}}, "not a fit"),
        ({"law": {"friction": "coulomb"}}, "law.friction = coulomb; wanted none"),
        ({"covariance": {"names": ["chi", "mu"], "matrix": [[1.0]]}}, "covariance of shape (1, 1) for 2 names"),
        ({"misfit": {"t_s": [0.0, 1.0], "position_m": [0.0], "rotation_rad": [0.0]}}, "misfit without as many"),
    ],
)
def test_a_file_that_is_no_fit_is_refused(
    throws: Path, fitted: Path, tmp_path: Path, change: dict, expected: str
) -> None:
    fit = {**json.loads(fitted.read_text()), **change}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    track, scene = throws / "throw_0.csv", throws / "scene.toml"
    status, _, notes = invoke(
        "predict", track, "--scene", scene, "--fit", tmp_path / "fit.json", "--out", tmp_path / "p.csv"
    )
    assert status == 1
    assert expected in " ".join(notes.split())
    assert not (tmp_path / "p.csv").exists()


def test_a_prediction_honours_the_motion_of_the_table_and_the_gravity_that_the_scene_states(tmp_path: Path) -> None:
    """A throw of the same law on the same table, with hardly any noise: what is predicted from its flight is what happened."""
    table = Table(amplitude_m=0.002, frequency_hz=20.0, phase_rad=0.4, gravity_m_s2=9.7)
    physics = Physics(CUBE, table, {"chi": 0.6})
    release = random_release(CUBE, np.random.default_rng(7))
    throw = physics.throw(release, Until(impacts=3)).throw
    track = replace(seen(throw, np.random.default_rng(3), noise=1e-6), gravity_m_s2=9.7)
    write_track(tmp_path / "throw.csv", track)
    chi = {"value": 0.6, "low": 0.6, "high": 0.6, "free": True, "at_bound": False, "level": 0.95}
    (tmp_path / "fit.json").write_text(json.dumps({"parameters": {"chi": chi}}))
    motion = "[table.motion]\namplitude_m = 0.002\nfrequency_hz = 20.0\nphase_rad = 0.4\n"
    world = "[world]\ngravity_m_s2 = 9.7\n"
    off = {}
    for name, more in (("stated", motion + world), ("at_rest", world)):
        (tmp_path / f"{name}.toml").write_text(f"[clip]\nfps = 1500.0\n{CUBE_ON_WOOD}{more}")
        wanted = (
            "--scene",
            tmp_path / f"{name}.toml",
            "--fit",
            tmp_path / "fit.json",
            "--out",
            tmp_path / f"{name}.csv",
        )
        status, _, notes = invoke("predict", tmp_path / "throw.csv", *wanted, "--draws", 0)
        assert status == 0, notes
        off[name] = json.loads((tmp_path / f"{name}.json").read_text())["position_error_m"]
    # The state before the first bounce is known to 1e-9 m, and three bounces let errors grow.
    assert off["stated"] < 1e-6
    assert off["at_rest"] > 1e-4


def test_a_track_whose_frames_repeat_or_go_back_is_refused(throws: Path, fitted: Path, tmp_path: Path) -> None:
    header, *rows = (throws / "throw_0.csv").read_text().splitlines(keepends=True)
    for number, text in ((3, "frame = 3 in row 5, after 3"), (1, "frame = 1 in row 5, after 3")):
        again = f"{number}{rows[4][rows[4].index(',') :]}"
        (tmp_path / "track.csv").write_text("".join([header, *rows[:4], again, *rows[5:]]))
        wanted = ("--scene", throws / "scene.toml", "--fit", fitted, "--out", tmp_path / "p.csv")
        status, _, notes = invoke("predict", tmp_path / "track.csv", *wanted)
        assert status == 1
        assert text in " ".join(notes.split())


def test_a_frame_that_the_track_does_not_allow_is_refused(throws: Path, fitted: Path, tmp_path: Path) -> None:
    for frame, expected in (
        ("soon", "--from-frame soon"),
        ("1", "at least 3"),
        ("9999", "--from-frame 9999"),
    ):
        wanted = ("--scene", throws / "scene.toml", "--fit", fitted, "--from-frame", frame, "--out", tmp_path / "p.csv")
        status, _, notes = invoke("predict", throws / "throw_0.csv", *wanted)
        assert status == 1
        assert expected in " ".join(notes.split())


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--misfit-limit", 9), "--misfit-limit = 9.0: wanted a ratio from 1.5 to 4"),
        (("--effects", "friction,magic"), "--effects friction,magic: 'magic' is no effect; wanted some of friction"),
        (("--usual-friction", "steel"), "--usual-friction = steel: wanted a coefficient of friction, or none"),
    ],
)
def test_a_choice_that_a_fit_does_not_have_is_refused_by_the_name_of_its_option(
    throws: Path, tmp_path: Path, options: tuple, expected: str
) -> None:
    where = ("--scene", throws / "scene.toml", "--out", tmp_path / "out")
    status, _, notes = invoke("fit", throws / "throw_0.csv", *where, *options)
    assert status == 2
    assert expected in " ".join(notes.split())
    assert not (tmp_path / "out").exists()


def test_choices_of_a_fit_are_in_its_file_and_in_the_command_that_repeats_it(throws: Path, tmp_path: Path) -> None:
    where = ("--scene", throws / "scene.toml", "--out", tmp_path / "out")
    options = ("--misfit-limit", 3.0, "--usual-friction", "none", "--intervals", "covariance", "--effects", "friction")
    status, _, notes = invoke("fit", throws / "throw_0.csv", *where, *options)
    assert status == 0, notes
    chosen = {"intervals": "covariance", "misfit_limit": 3.0, "usual_friction": None, "effects": ["friction"]}
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["choices"] == chosen
    repeated = json.loads((tmp_path / "out" / "provenance.json").read_text())["command"]
    assert {str(word) for word in options} <= set(repeated)
    status, _, notes = invoke("fit", throws / "throw_0.csv", throws / "throw_1.csv", *where, "--misfit-limit", 3.0)
    assert status == 2
    assert "--misfit-limit does not apply to several tracks" in " ".join(notes.split())
