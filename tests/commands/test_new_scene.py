"""`diethrow new`: from a folder with a clip, pictures of a board and a background to a scene that runs."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import invoke
from footage_files import write_photron, write_tiff, write_video
from footage_of_throws import DICE, film, studio
from pictures_of_boards import (
    CHARUCO_BOARD,
    DISTORTION,
    HEIGHT,
    MATRIX,
    WIDTH,
    on_table,
    picture,
    poses,
    table_pose_of,
)
from random_throws import random_quaternion

from diethrow.files.scene import read_scene
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.camera import Camera

CAMERA = Camera(WIDTH, HEIGHT, MATRIX, DISTORTION, *table_pose_of())
CUBE = DICE["cube"]
KNOWN = ("--yes", "--fps", 1500, "--edge-mm", 1e3 * CUBE.solid.edge_m, "--mass-g", 1e3 * CUBE.mass_kg)
BOARD = ("--square-mm", 10, "--marker-mm", 7.5)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a laboratory: a clip, a picture without the die, six of a board, one of the board on the table, notes."""
    folder = tmp_path_factory.mktemp("lab") / "throw_7"
    (folder / "board").mkdir(parents=True)
    texture = cv2.GaussianBlur(np.random.default_rng(7).normal(size=(HEIGHT, WIDTH)), (0, 0), 3.0)
    room = replace(studio(WIDTH, HEIGHT), camera=CAMERA, noise_grey=2.0)
    room = replace(room, table=np.asarray(75.0 + 7.0 * texture / texture.std(), np.float32))
    spin = np.array([6.0, 15.0, -4.0])
    release = State(0.0, np.array([0.0, 0.0, 0.034]), random_quaternion(np.random.default_rng(2)), np.zeros(3), spin)
    write_tiff(folder / "clip.tif", film(room, CUBE, Throw((Flight(release, 1.0),), ()), 40).array)
    cv2.imwrite(str(folder / "background.png"), np.rint(room.table).astype(np.uint8))
    for k, pose in enumerate(poses(6, CHARUCO_BOARD)):
        cv2.imwrite(str(folder / "board" / f"{k}.png"), picture(CHARUCO_BOARD, *pose, noise_grey=2.0))
    flat = picture(CHARUCO_BOARD, *on_table(CHARUCO_BOARD, *table_pose_of()), noise_grey=2.0)
    cv2.imwrite(str(folder / "board_on_table.png"), flat)
    (folder / "notes.txt").write_text("cork, second shelf")
    return folder


@pytest.fixture
def folder(filmed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(filmed, tmp_path / "throw_7"))


def test_a_folder_becomes_a_scene_that_runs(folder: Path) -> None:
    status, output, notes = invoke("new", folder, *KNOWN, *BOARD)
    assert status == 0, output + notes
    for name, role in (
        ("clip.tif", "clip: 40 frames of 480 x 400 pixels"),
        ("background.png", "background"),
        ("board_on_table.png", "board on the table"),
        ("notes.txt", "unknown"),
    ):
        assert any(name in line and role in line for line in output.splitlines()), (name, output)
    assert "calibrating from 6 pictures of the board" in output
    assert "Next:  diethrow analyze" in output
    scene = read_scene(folder / "scene.toml")
    view = scene.cameras[0]
    assert (scene.clip.fps, scene.die.solid.edge_m) == (1500.0, pytest.approx(CUBE.solid.edge_m))
    assert np.abs(view.camera.rotation - CAMERA.rotation).max() < 0.01
    assert view.calibration_path == folder / "camera" / "calibration.json"
    assert view.background_path == folder / "background.png"
    first = cv2.imread(str(folder / "first_frame.png"))
    # The edges of the die found are drawn in colour on the grey frame.
    assert (first.max(2).astype(int) - first.min(2) > 60).any()


def test_a_second_run_keeps_the_scene_and_needs_no_new_calibration(folder: Path) -> None:
    assert invoke("new", folder, *KNOWN, *BOARD)[0] == 0
    status, _, notes = invoke("new", folder, *KNOWN)
    assert status == 2
    assert "scene.toml exists" in notes
    status, output, _ = invoke("new", folder, *KNOWN, "--force")
    assert status == 0
    assert "calibration: a calibration that diethrow calibrate wrote" in output


def test_the_board_may_be_filmed(folder: Path) -> None:
    shown = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in sorted((folder / "board").iterdir())]
    flat = cv2.imread(str(folder / "board_on_table.png"), cv2.IMREAD_GRAYSCALE)
    shutil.rmtree(folder / "board")
    (folder / "board_on_table.png").unlink()
    write_video(folder / "board.mkv", np.repeat(np.array(shown), 4, axis=0))
    write_video(folder / "board_on_table.mkv", np.array([flat] * 12))
    status, output, notes = invoke("new", folder, *KNOWN, *BOARD)
    assert status == 0, output + notes
    said = " ".join(output.split())
    assert "board.mkv board: a film of the board, by its name: 24 frames" in said
    assert "board_on_table.mkv board on the table: a film of the board that lies on the table" in said
    assert np.abs(read_scene(folder / "scene.toml").cameras[0].camera.rotation - CAMERA.rotation).max() < 0.01


def test_what_is_missing_is_named_with_how_to_get_it(folder: Path) -> None:
    shutil.rmtree(folder / "board")
    (folder / "board_on_table.png").unlink()
    status, output, _ = invoke("new", folder, "--yes", "--edge-mm", 16)
    assert status == 1
    missing = [line for line in output.splitlines() if line.startswith("missing")]
    assert [line.split()[1] for line in missing] == ["fps:", "mass_kg:", "[camera]:"]
    assert "photograph a ChArUco board" in missing[2]
    text = (folder / "scene.toml").read_text()
    assert "# fps =   # recording rate, not that of a player" in text
    assert "edge_m = 0.016   # between corners, by caliper" in text


def test_questions_are_asked_only_about_what_the_files_do_not_say(folder: Path) -> None:
    """The die, then the rate, which a TIFF has not, then the board."""
    edge_mm = 1e3 * CUBE.solid.edge_m
    status, output, notes = invoke("new", folder, answers=f"cube\n{edge_mm}\n4.8\n1500\n10\n7.5\n")
    assert status == 0, output + notes
    assert "Recording rate" in output
    assert read_scene(folder / "scene.toml").die.mass_kg == pytest.approx(0.0048)


def test_a_camera_that_states_its_rate_is_believed(folder: Path) -> None:
    (folder / "clip.tif").unlink()
    write_photron(folder / "clip.cih", np.full((12, HEIGHT, WIDTH), 800, np.uint16), stored_bits=12)
    status, output, _ = invoke("new", folder, "--yes", "--json")
    record = json.loads(output)
    assert status == 1
    assert not any(sentence.startswith("fps") for sentence in record["missing"])
    assert "as the file says" in (folder / "scene.toml").read_text()


def test_of_several_films_the_longest_is_the_clip_and_a_folder_without_one_is_refused(folder: Path) -> None:
    write_tiff(folder / "short.tif", np.zeros((11, 8, 8), np.uint8))
    status, output, _ = invoke("new", folder, *KNOWN, *BOARD)
    assert status == 0
    assert any("short.tif" in line and "another film" in line for line in output.splitlines())
    for name in ("short.tif", "clip.tif", "scene.toml"):
        (folder / name).unlink()
    status, _, notes = invoke("new", folder, *KNOWN)
    assert status == 1
    assert "no film is in it; wanted an AVI" in notes
    status, _, notes = invoke("new", folder, *KNOWN, "--shape", "d10")
    assert status == 1
    assert "shape = d10: wanted tetrahedron" in notes
    status, _, notes = invoke("new", folder / "nowhere", *KNOWN)
    assert "there is no such folder" in notes
