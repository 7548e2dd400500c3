"""From a clip to a replay: the analysis of a rendered clip recovers its truth."""

from __future__ import annotations

import csv
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from diethrow.cli.app import app
from diethrow.files.fit_records import read_fit
from diethrow.files.scene import read_scene
from diethrow.files.throw_records import read_bounces, read_simulated, read_track, read_vertices
from diethrow.model.rotations import angle_between, matrix_from_quat
from diethrow.tracking.track import ABSENT, LOST, TRACKED

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "data_samples" / "cube_wood" / "scene.toml"
TRUTH = ROOT / "tests" / "data" / "cube_wood"
CHI = 0.5829

CONTRACT_FILES = {
    "vertices.csv",
    "track.csv",
    "track_covariance.npy",
    "bounces.csv",
    "fit.json",
    "simulated.csv",
    "replay.rrd",
    "report.html",
    "provenance.json",
}
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole_way") / "out"
    result = CliRunner().invoke(app, ["analyze", str(SCENE), "--figures", "--out", str(out)])
    assert result.exit_code == 0, result.stderr
    return out


@pytest.fixture(scope="module")
def truth() -> dict[str, Array]:
    """Columns of truth.csv."""
    with (TRUTH / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def true_poses(truth: dict[str, Array]) -> tuple[Array, Array]:
    positions = np.stack([truth[name] for name in "xyz"], axis=1)
    return positions, matrix_from_quat(np.stack([truth[name] for name in ("qw", "qx", "qy", "qz")], axis=1))


def cube_rotations() -> list[Array]:
    """The 24 rotations of a cube, whose faces differ by their pips only: the numbering of the axes is arbitrary."""
    turned = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                turned.append(matrix)
    return turned


def test_every_file_exists_and_none_is_empty(folder: Path) -> None:
    assert {file.name for file in folder.iterdir()} >= CONTRACT_FILES
    assert all(file.stat().st_size > 0 for file in folder.iterdir())
    assert [path.name for path in folder.parent.iterdir()] == ["out"]


def test_figures_are_written_on_request(folder: Path) -> None:
    names = {file.stem for file in (folder / "figures").iterdir()}
    assert names >= {
        "stroboscope",
        "bounces",
        "heights",
        "restitution",
        "residuals_position_sigmas",
        "correlations",
        "odds",
    }
    assert {file.name for file in (folder / "figures").iterdir()} == {
        f"{n}.{kind}" for n in names for kind in ("png", "svg")
    }


def test_the_report_states_provenance_and_checks(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    origin = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    assert all(file["sha256"] in text for file in origin["inputs"])
    assert "m/s² (95 %)" in text
    assert "mm (95 %" in text


def test_every_frame_has_a_row_in_every_track(folder: Path, truth: dict[str, Array]) -> None:
    track = read_track(folder / "track.csv")
    assert set(track.status) <= {TRACKED, LOST, ABSENT}
    for other in (read_track(folder / "track_frames.csv"), read_simulated(folder / "simulated.csv")):
        np.testing.assert_array_equal(other.frame, track.frame)
        np.testing.assert_array_equal(other.time_s, track.time_s)
    np.testing.assert_array_equal(track.frame, np.arange(len(truth["t"])))
    np.testing.assert_allclose(track.time_s, truth["t"], atol=1e-12)


def test_the_poses_are_the_true_ones(folder: Path, truth: dict[str, Array]) -> None:
    track = read_track(folder / "track.csv")
    visible = truth["fully_visible"] == 1
    assert track.tracked[visible].mean() >= 0.99
    both = visible & track.tracked
    positions, rotations = true_poses(truth)
    camera = read_scene(SCENE).views()[0].camera
    error = (track.position_m[both] - positions[both]) @ camera.rotation.T
    # Across the line of sight; along it one camera sees several times worse.
    assert np.median(np.linalg.norm(error[:, :2], axis=1)) < 0.02e-3
    measured = matrix_from_quat(track.quaternion[both])
    angles = [angle_between(measured @ turn, rotations[both]) for turn in cube_rotations()]
    best = np.rad2deg(min(angles, key=np.median))
    assert np.median(best) < 0.1
    assert np.percentile(best, 95) < 0.5
    assert best.max() < 5.0


def test_the_bounces_are_the_true_ones(folder: Path) -> None:
    with (TRUTH / "bounces.csv").open(newline="") as file:
        times = [float(row["t"]) for row in csv.DictReader(file)]
    impacts = read_bounces(folder / "bounces.csv")
    assert [impact.contact for impact in impacts] == ["vertex"] * len(times)
    # A tenth of a frame.
    np.testing.assert_allclose([impact.time_s for impact in impacts], times, atol=0.1 / 1500.0)
    corners = len(read_vertices(folder / "vertices.csv"))
    assert all(0 <= vertex < corners for impact in impacts for vertex in impact.vertices)


def test_the_restitution_is_the_true_one_and_inside_its_interval(folder: Path) -> None:
    chi = read_fit(folder / "fit.json").parameters["chi"]
    assert chi.value is not None
    assert chi.low is not None
    assert chi.high is not None
    assert abs(chi.value - CHI) < 0.005
    assert chi.low <= CHI <= chi.high
    assert chi.level == 0.95


def test_with_a_quarter_of_gravity_the_same_pictures_take_twice_the_time(folder: Path, tmp_path: Path) -> None:
    """The motions of rigid bodies under k g are those under g, slower by the root of k: poses and restitution are the same."""
    for name in ("clip.mp4", "background.png"):
        (tmp_path / name).symlink_to(SCENE.parent / name)
    text = (
        SCENE.read_text().replace("fps = 1500.0", "fps = 750.0").replace("exposure_s = 0.0002", "exposure_s = 0.0004")
    )
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{text}\n[world]\ngravity_m_s2 = {9.81 / 4!r}\n")
    for name, command in {
        "out": ["analyze", str(scene)],
        "fitted": ["fit", str(tmp_path / "out" / "track_frames.csv"), "--scene", str(scene)],
    }.items():
        result = CliRunner().invoke(app, [*command, "--out", str(tmp_path / name)])
        assert result.exit_code == 0, result.stderr
    usual, slow = read_track(folder / "track.csv"), read_track(tmp_path / "out" / "track.csv")
    assert np.array_equal(usual.status, slow.status)
    np.testing.assert_allclose(slow.time_s, 2.0 * usual.time_s)
    both = usual.tracked
    # Errors along the line of sight are 25 times as large. Where rounding ends refinements depends on the processor.
    assert np.linalg.norm(slow.position_m - usual.position_m, axis=1)[both].max() < 3e-6
    assert angle_between(slow.quaternion[both], usual.quaternion[both]).max() < 1e-4
    for name in ("out", "fitted"):
        chi, again = (read_fit(path / "fit.json").parameters["chi"] for path in (folder, tmp_path / name))
        assert again.value == pytest.approx(chi.value, abs=1e-4)
        assert again.low == pytest.approx(chi.low, abs=5e-4)
        assert again.high == pytest.approx(chi.high, abs=5e-4)
        here, there = (read_bounces(path / "bounces.csv") for path in (folder, tmp_path / name))
        for one, other in zip(here, there, strict=True):
            assert other.time_s == pytest.approx(2.0 * one.time_s, abs=1e-6)
            assert other.energy_before_J == pytest.approx(0.25 * one.energy_before_J, rel=1e-3)
            assert other.energy_after_J == pytest.approx(0.25 * one.energy_after_J, rel=1e-3)


def test_a_fit_of_the_tracked_frames_is_that_of_the_analysis(folder: Path, tmp_path: Path) -> None:
    """With a camera that is known only so far, and faces whose numbers only the pictures show."""
    scene = tmp_path / "scene.toml"
    known = {'calibration = "exact"\n': "", "edge_sigma_m = 0.0\n": "", "fps_sigma = 0.0\n": ""}
    text = SCENE.read_text()
    for stated, nothing in known.items():
        text = text.replace(stated, nothing)
    scene.write_text(text)
    for name in ("clip.mp4", "background.png"):
        (tmp_path / name).symlink_to(SCENE.parent / name)
    frames = tmp_path / "out" / "track_frames.csv"
    for name, command in {
        "out": ["analyze", str(scene), "--quality", "fast"],
        "fitted": ["fit", str(frames), "--scene", str(scene)],
    }.items():
        result = CliRunner().invoke(app, [*command, "--out", str(tmp_path / name)])
        assert result.exit_code == 0, result.stderr
    for file in ("fit.json", "bounces.csv", "simulated.csv"):
        assert (tmp_path / "out" / file).read_bytes() == (tmp_path / "fitted" / file).read_bytes()
    usual, exact = read_fit(tmp_path / "out" / "fit.json"), read_fit(folder / "fit.json")
    assert any("Assumed" in message and "camera.calibration" in message for message in usual.messages)
    assert not any("Assumed" in message for message in exact.messages)
    assert sum(usual.variance_shares["chi"].values()) == pytest.approx(1.0)
    assert not exact.variance_shares
    wide, narrow = (one.parameters["chi"] for one in (usual, exact))
    assert wide.high - wide.low > narrow.high - narrow.low
    assert wide.low <= CHI <= wide.high


def test_what_lies_beside_a_track_belongs_to_it(folder: Path, tmp_path: Path) -> None:
    for name in ("track_frames.csv", "track_frames_covariance.npy"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    stored = tmp_path / "track_frames_throw.npz"
    command = ["fit", str(tmp_path / "track_frames.csv"), "--scene", str(SCENE), "--out", str(tmp_path / "fit")]
    whole = (folder / stored.name).read_bytes()
    with np.load(folder / stored.name) as data:
        fewer = {name: data[name] for name in data.files}
    fewer["frame"] = fewer["frame"][1:]
    for damage in ("cut", "of another track", "no archive"):
        if damage == "of another track":
            np.savez(stored, **fewer)
        else:
            stored.write_bytes(whole[: len(whole) // 2] if damage == "cut" else b"no archive")
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 1, damage
        assert "track_frames_throw.npz" in result.stderr
        assert "to fit the table alone" in result.stderr
        assert "Traceback" not in result.stderr
        assert not (tmp_path / "fit").exists()
    stored.unlink()
    assert CliRunner().invoke(app, command).exit_code == 0
    chi = read_fit(tmp_path / "fit" / "fit.json").parameters["chi"]
    assert chi.low <= CHI <= chi.high


def test_the_models_track_lies_on_the_measured_one(folder: Path) -> None:
    track, simulated = read_track(folder / "track.csv"), read_simulated(folder / "simulated.csv")
    both = track.tracked & simulated.tracked
    assert both.sum() > 0.8 * track.tracked.sum()
    distance = np.linalg.norm(track.position_m[both] - simulated.position_m[both], axis=1)
    # A tenth of a millimetre in depth is what one camera leaves open.
    assert np.median(distance) < 0.5e-3


def test_the_provenance_names_every_input(folder: Path) -> None:
    origin = json.loads((folder / "provenance.json").read_text())
    named = {Path(entry["path"]).name for entry in origin["inputs"]}
    scene = read_scene(SCENE)
    view = scene.views()[0]
    assert view.path is not None
    assert view.background_path is not None
    assert named == {"scene.toml", view.path.name, view.background_path.name}
    assert set(origin["timings_s"]) == {"open", "track", "bounces", "fit", "estimates", "replay", "report"}


def test_the_time_line_has_every_stage_of_every_thread(folder: Path) -> None:
    """Stages of the main thread follow each other and last as `timings_s` says; the film is encoded beside them."""
    origin = json.loads((folder / "provenance.json").read_text())
    line = origin["time_line"]
    main = [row for row in line if row["thread"] == "main"]
    assert {row["stage"]: row["wall_s"] for row in main} == origin["timings_s"]
    for row, after in itertools.pairwise(main):
        assert row["start_s"] + row["wall_s"] <= after["start_s"] + 1e-3
    (video,) = [row for row in line if row["thread"] != "main"]
    assert (video["stage"], video["thread"]) == ("video", "encoder")
    track = next(row for row in main if row["stage"] == "track")
    assert video["start_s"] < track["start_s"] + track["wall_s"]
    assert all(0.0 <= row["processor_s"] <= row["wall_s"] + 0.05 for row in line)
