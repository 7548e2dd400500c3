"""`diethrow check` prints every verdict, ends with status 1 if one is bad, and writes a page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import invoke
from footage_files import write_photron, write_tiff
from footage_of_throws import DICE, film, studio
from random_throws import random_quaternion

from diethrow.model.throw.motion import Flight, State, Throw

ROOM = replace(studio(), noise_grey=2.0)
FRAMES = 40


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cube in free flight through the picture, and the scene file of its clip."""
    folder = tmp_path_factory.mktemp("clip")
    spin = np.array([6.0, 15.0, -4.0])
    release = State(0.0, np.array([0.0, 0.0, 0.034]), random_quaternion(np.random.default_rng(2)), np.zeros(3), spin)
    clip = film(ROOM, DICE["cube"], Throw((Flight(release, 1.0),), ()), FRAMES)
    write_tiff(folder / "clip.tif", clip.array)
    cv2.imwrite(str(folder / "background.png"), np.rint(ROOM.table).astype(np.uint8))
    camera, die = ROOM.camera, DICE["cube"]
    lines = [
        "[clip]", 'path = "clip.tif"', "fps = 1500.0", "exposure_s = 1e-4", 'background = "background.png"',
        "[camera]", f"width = {camera.width_px}", f"height = {camera.height_px}",
        *(f"{name} = {getattr(camera, name).tolist()}" for name in ("matrix", "distortion", "rotation", "translation_m")),
        "[table]", 'surface = "wood"',
        "[die]", 'shape = "cube"', f"edge_m = {die.solid.edge_m}", f"mass_kg = {die.mass_kg}",
    ]  # fmt: skip
    path = folder / "scene.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_good_clip_is_checked_and_its_page_needs_no_network(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "check"
    status, output, _ = invoke("check", scene, "--out", out)
    assert status == 0
    names = (
        *("timing", "background", "light", "die", "pixels", "motion blur", "sharpness", "shutter", "corners"),
        *("scale", "vertical", "table"),
    )
    assert all(name in output for name in names)
    assert {file.name for file in out.iterdir()} == {"check.json", "check.html", "provenance.json"}
    record = json.loads((out / "check.json").read_text())
    assert [each["name"] for each in record["findings"]] == list(names)
    assert record["verdict"] in ("good", "doubtful")
    # A scale good to a few per cent is all that forty frames, 27 ms, can say; its interval holds the truth.
    values = next(each for each in record["findings"] if each["name"] == "scale")["values"]
    assert abs(values["edge_from_fall_m"] - DICE["cube"].solid.edge_m) < 1.5 * values["edge_from_fall_half_width_m"]
    page = (out / "check.html").read_text()
    assert "://" not in page.replace("http://www.w3.org", "")
    assert invoke("check", scene, "--out", out)[0] == 2


def test_every_camera_is_checked_and_named(scene: Path, tmp_path: Path) -> None:
    text = scene.read_text().replace("background", "#background").replace("path =", "#path =")
    table = text[text.index("[camera]") : text.index("[table]")]
    own = f'path = "{scene.parent / "clip.tif"}"\nbackground = "{scene.parent / "background.png"}"\n'
    other = tmp_path / "scene.toml"
    twice = table.replace("[camera]", "[[camera]]") + own
    # The same clip twice, the second time with a background in other light.
    other.write_text(text.replace(table, twice + twice.replace('background.png"', 'nothing.png"')))
    cv2.imwrite(str(scene.parent / "nothing.png"), np.rint(ROOM.table + 60).astype(np.uint8))
    out = tmp_path / "check"
    status, output, _ = invoke("check", other, "--allow-outside", "--out", out)
    assert status == 1
    record = json.loads((out / "check.json").read_text())
    verdicts = {each["name"]: each["verdict"] for each in record["findings"]}
    assert verdicts["background, camera 1"] == "good"
    assert verdicts["background, camera 2"] == "bad"
    assert "camera 2" in output
    assert len(record["frames_tried"]) == 2
    assert "of camera 1" in (out / "check.html").read_text()


def test_a_bad_verdict_ends_with_status_1(scene: Path, tmp_path: Path) -> None:
    text = scene.read_text().replace('"clip.tif"', f'"{scene.parent / "clip.tif"}"')
    bright = tmp_path / "bright.png"
    cv2.imwrite(str(bright), np.rint(ROOM.table + 60).astype(np.uint8))
    other = tmp_path / "scene.toml"
    other.write_text(text.replace('"background.png"', f'"{bright}"'))
    status, output, _ = invoke("check", other, "--allow-outside")
    assert status == 1
    assert "bad" in output


def test_a_missing_clip_is_one_sentence(scene: Path, tmp_path: Path) -> None:
    other = tmp_path / "scene.toml"
    other.write_text(scene.read_text())
    status, _, output = invoke("check", other)
    assert status == 2
    assert len(output.strip().splitlines()) == 1


def test_a_film_of_one_picture_is_refused_with_its_name(scene: Path, tmp_path: Path) -> None:
    picture = np.rint(ROOM.table).astype(np.uint8)
    write_tiff(tmp_path / "still.tif", np.array([picture] * 5))
    path = tmp_path / "scene.toml"
    path.write_text(scene.read_text().replace("clip.tif", "still.tif").replace('background = "background.png"', ""))
    status, _, output = invoke("check", path)
    assert status == 2
    assert 'clip.path = "still.tif": all 5 frames of it are copies of one picture' in output


@pytest.mark.parametrize("key", ["exposure_s", "readout_s"])
def test_times_longer_than_the_interval_of_the_file_are_refused(scene: Path, tmp_path: Path, key: str) -> None:
    frames = np.random.default_rng(1).integers(0, 255, (4, *ROOM.table.shape)).astype(np.uint16)
    write_photron(tmp_path / "x.cihx", frames, stored_bits=16)
    lines = [
        line for line in scene.read_text().splitlines() if not line.startswith(("fps", "background", "exposure_s"))
    ]
    path = tmp_path / "scene.toml"
    path.write_text("\n".join(lines).replace('"clip.tif"', f'"x.cihx"\n{key} = 0.5'))
    status, _, output = invoke("check", path)
    assert status == 2
    assert f"clip.{key} = 0.5: wanted seconds, at most the" in output
