"""Messages on faulty footage and faulty output folders."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from footage_files import write_video
from typer.testing import CliRunner

from diethrow.cli.app import app
from diethrow.files.outputs import OutputPlaceError, whole_folder

SCENE = """\
[clip]
path = "clip.avi"
fps = 1500.0
background = "background.png"
[camera]
width = 96
height = 64
matrix = [[700.0, 0.0, 47.5], [0.0, 700.0, 31.5], [0.0, 0.0, 1.0]]
rotation = [[1.0, 0.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.8, -0.6]]
translation_m = [0.0, 0.02, 0.6]
[table]
surface = "wood"
[die]
shape = "cube"
edge_m = 0.016
mass_kg = 0.0048
"""


@pytest.fixture
def cut_scene(tmp_path: Path) -> Path:
    """A film of thirty frames of an empty table, cut off after two thirds of its bytes."""
    rng = np.random.default_rng(5)
    ground = np.tile(np.linspace(60, 160, 96), (64, 1))
    frames = (ground + rng.normal(0, 2, (30, 64, 96))).round().astype(np.uint8)
    whole = tmp_path / "whole.avi"
    write_video(whole, frames, codec="ffv1", pixels="gray", fps=30)
    content = whole.read_bytes()
    (tmp_path / "clip.avi").write_bytes(content[: len(content) * 2 // 3])
    cv2.imwrite(str(tmp_path / "background.png"), ground.round().astype(np.uint8))
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_a_truncated_clip_without_a_die_is_reported_as_truncated(cut_scene: Path, tmp_path: Path) -> None:
    """Once the message named only the missing die, and a truncated copy went unnoticed."""
    result = CliRunner().invoke(app, ["track", str(cut_scene), "--out", str(tmp_path / "out")])
    assert result.exit_code == 1
    note, sentence = result.stderr.strip().splitlines()
    assert note.startswith("note: clip.avi")
    assert "cut off" in note
    assert "no die" in sentence
    assert not (tmp_path / "out").exists()


def test_an_impossible_output_folder_is_one_sentence_with_advice(tmp_path: Path) -> None:
    """Once the message was `[Errno 17] File exists`, which named neither the option nor the cause."""
    (tmp_path / "notes.txt").write_text("kept")
    message = r"cannot be made \(.+\); wanted a place .+ another --out"
    with pytest.raises(OutputPlaceError, match=message), whole_folder(tmp_path / "notes.txt" / "out"):
        pass
    with pytest.raises(OutputPlaceError, match="name too long"), whole_folder(tmp_path / ("a" * 300)):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_output_path_inside_a_file_ends_with_status_2(cut_scene: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["track", str(cut_scene), "--out", str(cut_scene / "out")])
    assert result.exit_code == 2
    assert result.stderr.startswith("diethrow: ")
    assert "Errno" not in result.stderr
