"""`diethrow watch`: clips that appear in a folder are analysed when they are complete, and nothing is done twice."""

from __future__ import annotations

import csv
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import invoke
from footage_files import write_tiff
from footage_of_throws import DICE, falling_cube, film, studio

from diethrow.commands.results.watched_folder import Watched, watch
from diethrow.files.scene import read_scene
from diethrow.model.errors import InputError

ROOM = replace(studio(), noise_grey=2.0)
CAMERA, CUBE = ROOM.camera, DICE["cube"]
TEMPLATE = "\n".join(
    [
        "[clip]", 'path = "some_clip.tif"', "fps = 1500.0", "exposure_s = 1e-4",
        "[camera]", f"width = {CAMERA.width_px}", f"height = {CAMERA.height_px}", 'calibration = "exact"',
        *(f"{name} = {getattr(CAMERA, name).tolist()}" for name in ("matrix", "distortion", "rotation", "translation_m")),
        "[table]", 'surface = "wood"',
        "[die]", 'shape = "cube"', f"edge_m = {CUBE.solid.edge_m}", f"mass_kg = {CUBE.mass_kg}", "",
    ]
)  # fmt: skip


def write_clip(path: Path, seed: int) -> bytes:
    """A throw with one bounce."""
    throw = falling_cube(64 / 1500.0, spin_rad_s=20.0 + seed)
    write_tiff(path, film(ROOM, CUBE, throw, 64, seed=seed).array)
    return path.read_bytes()


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[Watched]]:
    """A day: one clip is there, a second is being written while the first is analysed, and no film is saved as well."""
    folder = tmp_path_factory.mktemp("camera")
    out = tmp_path_factory.mktemp("results") / "today"
    (folder / "scene.toml").write_text(TEMPLATE)
    (folder / "notes.txt").write_text("cork")
    write_clip(folder / "throw_1.tif", 1)
    second = write_clip(folder / "throw_2.part", 2)
    (folder / "throw_2.part").unlink()
    steps = iter(
        [
            lambda: None,
            lambda: (folder / "throw_2.tif").write_bytes(second[: len(second) // 2]),
            lambda: (folder / "throw_2.tif").write_bytes(second),
        ]
    )
    reported: list[Watched] = []
    with ThreadPoolExecutor(1) as executor:
        watch(
            folder,
            folder / "scene.toml",
            out,
            joint_every=2,
            looks=6,
            executor=executor,
            reported=reported.append,
            sleep=lambda seconds: next(steps, lambda: None)(),
        )
    return folder, out, reported


def test_each_clip_is_analysed_once_when_it_is_complete(watched: tuple[Path, Path, list[Watched]]) -> None:
    _, out, reported = watched
    assert [(len(one.batch.results), one.new) for one in reported] == [(1, 1), (2, 1)]
    assert [one.batch.kept for one in reported] == [0, 1]
    with (out / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [Path(row["scene"]).stem for row in rows] == ["throw_1", "throw_2"]
    assert all(row["bounces"] == "1" for row in rows)


def test_each_clip_has_a_scene_of_its_own_made_from_the_template(watched: tuple[Path, Path, list[Watched]]) -> None:
    folder, _, _ = watched
    scene = read_scene(folder / "throw_2.toml")
    assert scene.cameras[0].path == folder / "throw_2.tif"
    assert scene.die.solid.edge_m == CUBE.solid.edge_m
    assert (folder / "throw_2.toml").read_text() == TEMPLATE.replace("some_clip.tif", "throw_2.tif")


def test_the_page_has_a_row_and_a_picture_of_every_throw(watched: tuple[Path, Path, list[Watched]]) -> None:
    _, out, _ = watched
    page = (out / "index.html").read_text()
    for name in ("throw_1", "throw_2"):
        assert f'<a href="{name}/report.html">' in page
        assert (out / name / "report.html").exists()
        assert (out / "pictures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert page.index("throw_2") < page.index("throw_1")
    assert "://" not in page.replace("http://www.w3.org", "")


def test_the_joint_fit_follows_after_every_so_many_throws(watched: tuple[Path, Path, list[Watched]]) -> None:
    _, out, reported = watched
    assert [one.joint_fit for one in reported] == [None, out / "joint"]
    joint = json.loads((out / "joint" / "fit.json").read_text())
    assert [throw["track"] for throw in joint["throws"]] == ["throw_1", "throw_2"]


def test_the_same_command_goes_on_where_it_stopped(watched: tuple[Path, Path, list[Watched]]) -> None:
    folder, out, _ = watched
    before = (out / "throw_1" / "fit.json").stat().st_mtime_ns
    status, output, notes = invoke(
        "watch", folder, "--scene", folder / "scene.toml", "--out", out, "--once", "--poll-s", 0.1
    )
    assert status == 0, notes
    assert "2 throws, 0 failures, 2 new" in output
    assert (out / "throw_1" / "fit.json").stat().st_mtime_ns == before


def test_what_cannot_be_watched_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("[die]\n")
    with pytest.raises(InputError, match="no such folder; wanted the one that the camera saves to"):
        watch(tmp_path / "nowhere", tmp_path / "scene.toml", tmp_path / "out", looks=1)
    with pytest.raises(InputError, match=r"has no \[clip\] table"):
        watch(tmp_path, tmp_path / "scene.toml", tmp_path / "out", looks=1)


def test_a_clip_that_fails_is_named_and_the_others_go_on(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(TEMPLATE)
    write_tiff(tmp_path / "nothing.tif", np.full((20, 200, 200), 80, np.uint8))
    reported: list[Watched] = []
    with ThreadPoolExecutor(1) as executor:
        watch(tmp_path, tmp_path / "scene.toml", tmp_path / "out", looks=2, executor=executor, reported=reported.append,
              sleep=lambda seconds: None)  # fmt: skip
    assert [failure.kind for failure in reported[0].batch.failures] == ["scene"]
    assert "nothing" in (tmp_path / "out" / "index.html").read_text()


def test_clips_of_one_name_have_scenes_of_their_own(tmp_path: Path) -> None:
    template = tmp_path / "throw.toml"
    template.write_text(TEMPLATE)
    for name in ("throw.tif", "other.tif", "other.tiff"):
        write_clip(tmp_path / name, 3)
    reported: list[Watched] = []
    with ThreadPoolExecutor(1) as executor:
        watch(tmp_path, template, tmp_path / "out", looks=2, executor=executor, reported=reported.append,
              sleep=lambda seconds: None)  # fmt: skip
    assert {path.name for path in tmp_path.glob("*.toml")} == {
        "throw.toml", "throw_tif.toml", "other.toml", "other_tiff.toml"
    }  # fmt: skip
    assert len(reported[0].batch.results) == 3
    assert template.read_text() == TEMPLATE
