"""`diethrow calibrate` writes a camera table that a scene accepts, and refuses unusable pictures."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import invoke
from footage_files import write_cine, write_video
from pictures_of_boards import CHARUCO_BOARD, MATRIX, on_table, picture, poses, table_pose_of

from diethrow.commands.clip.track import input_paths
from diethrow.files.scene import SceneError, read_scene

OPTIONS = ("--square-mm", "10", "--marker-mm", "7.5")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Six of the tilted board and, last, one of it on the table."""
    folder = tmp_path_factory.mktemp("pictures")
    where = [*poses(6, CHARUCO_BOARD), on_table(CHARUCO_BOARD, *table_pose_of())]
    paths = []
    for k, pose in enumerate(where):
        paths.append(folder / f"{k}.png")
        assert cv2.imwrite(str(paths[-1]), picture(CHARUCO_BOARD, *pose, noise_grey=2.0))
    return paths


def test_the_written_camera_is_that_of_the_pictures_and_fits_a_scene(pictures: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "camera"
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), np.full((400, 480), 90, np.uint8))
    status, output, notes = invoke("calibrate", *pictures[:-1], empty, "--table", pictures[-1], *OPTIONS, "--out", out)
    assert status == 0
    assert "7 of 8 pictures" in output
    assert "No board is found on 1 of the pictures (empty.png)" in notes
    assert {file.name for file in out.iterdir()} == {
        "camera.toml", "calibration.json", "calibration.html", "provenance.json"
    }  # fmt: skip
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "[clip]\nfps = 1500.0\n" + (out / "camera.toml").read_text()
        + '[table]\nsurface = "wood"\n[die]\nshape = "cube"\nedge_m = 0.016\nmass_kg = 0.0048\n'
    )  # fmt: skip
    camera = read_scene(scene).cameras[0].camera
    rotation, shift = table_pose_of()
    record = json.loads((out / "calibration.json").read_text())
    sigma = record["intrinsics"]["fx"]["sigma"]
    # Blur and neighbouring squares correlate the errors of the corners: six sigmas of white noise, and a hundredth of a radian.
    assert abs(camera.matrix[0, 0] - MATRIX[0, 0]) < 6.0 * sigma
    assert sigma < 10.0
    assert np.abs(camera.rotation - rotation).max() < 0.01
    assert np.linalg.norm(camera.translation_m - shift) < 0.006
    names, C = record["covariance_names"], np.array(record["covariance"])
    assert names[:4] == ["fx", "fy", "cx", "cy"]
    assert names[-7:] == ["rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "x_m", "y_m", "z_m", "board_scale"]
    assert C.shape == (len(names), len(names))
    assert np.sqrt(C[0, 0]) == pytest.approx(sigma)
    assert np.sqrt(C[-1, -1]) == pytest.approx(1e-3)
    assert (np.linalg.eigvalsh(C / np.sqrt(np.outer(np.diag(C), np.diag(C)))) > 0.0).all()
    (tmp_path / "calibration.json").write_bytes((out / "calibration.json").read_bytes())
    text = scene.read_text()
    assert '# calibration = "calibration.json"' in text
    scene.write_text(text.replace("# calibration", "calibration"))
    stated = read_scene(scene)
    assert tmp_path / "calibration.json" in input_paths(stated)
    known = stated.known_errors(None)
    assert np.sqrt(known.covariances[0][0, 0]) == pytest.approx(sigma)
    # The pose is the last but the scale of the board, which the camera's place contains.
    np.testing.assert_allclose(known.covariances[0][9:, 9:], C[-7:-1, -7:-1])
    for change, message in (
        (lambda other: other["intrinsics"]["fx"].update(value=1.0), "another matrix"),
        (lambda other: other["table"].update(translation_m=[0.0, 0.0, 1.0]), "at another place"),
        (lambda other: other.update(covariance=[[1.0]]), r"shape \(1, 1\)"),
        (lambda other: other["covariance"][0].__setitem__(0, -1.0), "variance below 0"),
    ):
        other = json.loads((out / "calibration.json").read_text())
        change(other)
        (tmp_path / "calibration.json").write_text(json.dumps(other))
        with pytest.raises(SceneError, match=message):
            read_scene(scene)
    page = (out / "calibration.html").read_text()
    assert "://" not in page.replace("http://www.w3.org", "")


def test_films_of_the_board_stand_for_pictures(tmp_path: Path) -> None:
    """As a phone takes them: compressed, the board in motion, and with a playback rate alone."""
    shown = np.array([picture(CHARUCO_BOARD, *pose, noise_grey=2.0) for pose in poses(40, CHARUCO_BOARD)])
    flat = np.array([picture(CHARUCO_BOARD, *on_table(CHARUCO_BOARD, *table_pose_of()), noise_grey=2.0)] * 12)
    made = {"codec": "libx264", "pixels": "yuv420p", "fps": 30, "options": {"crf": "20"}}
    board = write_video(tmp_path / "board.mp4", shown, **made)
    table = write_video(tmp_path / "board_on_table.mp4", flat, **made)
    out = tmp_path / "camera"
    status, output, notes = invoke("calibrate", board, "--table", table, *OPTIONS, "--out", out)
    assert status == 0, notes
    assert "25 of 25 pictures" in output
    record = json.loads((out / "calibration.json").read_text())
    names = [Path(each["name"]).name for each in record["pictures"]]
    assert names[:2] == ["board.mp4", "board.mp4, frame 1"]
    assert names[-1] == "board_on_table.mp4"
    assert len(set(names)) == 25
    focal = record["intrinsics"]["fx"]
    assert abs(focal["value"] - MATRIX[0, 0]) < 6.0 * focal["sigma"]
    assert np.abs(np.array(record["table"]["rotation"]) - table_pose_of()[0]).max() < 0.01


def test_without_a_table_picture_the_pose_is_omitted_with_a_hint(pictures: list[Path], tmp_path: Path) -> None:
    assert invoke("calibrate", *pictures, *OPTIONS, "--out", tmp_path / "c")[0] == 0
    assert "--table" in (tmp_path / "c" / "camera.toml").read_text()
    status, _, output = invoke("calibrate", *pictures, *OPTIONS, "--out", tmp_path / "c")
    assert status == 2
    assert "exists" in output


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (("--square-mm", "10"), 2, "marker_mm = missing"),
        ((*OPTIONS, "--squares", "7"), 2, "squares = 7; wanted two whole numbers"),
        ((*OPTIONS, "--squares", "9x9"), 1, "the board is usable on 0 pictures"),
        ((*OPTIONS, "--table", "none.png"), 1, "none.png"),
    ],
)
def test_unusable_pictures_end_in_one_sentence(
    words: tuple[str, ...], status: int, message: str, pictures: list[Path], tmp_path: Path
) -> None:
    ended, _, output = invoke("calibrate", *pictures[:4], *words, "--out", tmp_path / "c")
    assert ended == status
    assert message in output
    assert len(output.strip().splitlines()) == 1
    assert not (tmp_path / "c").exists()


def test_pictures_of_two_sizes_are_refused(pictures: list[Path], tmp_path: Path) -> None:
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((60, 80), np.uint8))
    assert "is 80 × 60 px" in invoke("calibrate", *pictures[:3], small, *OPTIONS, "--out", tmp_path / "c")[2]


def test_a_film_serves_as_a_picture_by_its_first_frame(pictures: list[Path], tmp_path: Path) -> None:
    board = cv2.imread(str(pictures[-1]), cv2.IMREAD_GRAYSCALE)
    film = write_cine(tmp_path / "table.cine", np.stack([board, 0 * board]), stored_bits=8)
    assert invoke("calibrate", *pictures[:-1], "--table", film, *OPTIONS, "--out", tmp_path / "film")[0] == 0
    assert invoke("calibrate", *pictures[:-1], "--table", pictures[-1], *OPTIONS, "--out", tmp_path / "picture")[0] == 0
    from_film, from_picture = (
        tomllib.loads((tmp_path / name / "camera.toml").read_text())["camera"] for name in ("film", "picture")
    )
    # The optimiser's threads add up in any order: from run to run it ends within 1e-10 of the same place.
    for key in ("matrix", "distortion", "rotation", "translation_m"):
        np.testing.assert_allclose(from_film[key], from_picture[key], rtol=1e-6, atol=1e-8)
