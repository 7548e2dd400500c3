"""Messages on faulty footage and faulty output folders."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from command_line import CUBE_ON_WOOD, SMALL_CAMERA, empty_table, invoke, text_file
from footage_files import write_video

from diethrow.files.outputs import OutputPlaceError, whole_folder

CLIP = '[clip]\npath = "clip.avi"\nfps = 1500.0\nbackground = "background.png"\n'


@pytest.fixture
def cut_scene(tmp_path: Path) -> Path:
    """A film of thirty frames of an empty table, cut off after two thirds of its bytes."""
    background, frames = empty_table(5)
    whole = tmp_path / "whole.avi"
    write_video(whole, frames, codec="ffv1", pixels="gray", fps=30)
    content = whole.read_bytes()
    (tmp_path / "clip.avi").write_bytes(content[: len(content) * 2 // 3])
    cv2.imwrite(str(tmp_path / "background.png"), background)
    return text_file(tmp_path / "scene.toml", CLIP + SMALL_CAMERA + CUBE_ON_WOOD)


def test_a_truncated_clip_without_a_die_is_reported_as_truncated(cut_scene: Path, tmp_path: Path) -> None:
    """An earlier message named the missing die only, so that a truncated copy went unnoticed."""
    status, _, messages = invoke("track", cut_scene, "--out", tmp_path / "out")
    assert status == 1
    note, sentence = messages.strip().splitlines()
    assert note.startswith("note: clip.avi")
    assert "cut off" in note
    assert "no die" in sentence
    assert not (tmp_path / "out").exists()


def test_an_impossible_output_folder_is_one_sentence_with_advice(tmp_path: Path) -> None:
    """An earlier message was `[Errno 17] File exists`, without the option and the cause."""
    (tmp_path / "notes.txt").write_text("kept")
    message = r"cannot be made \(.+\); wanted a place .+ another --out"
    with pytest.raises(OutputPlaceError, match=message), whole_folder(tmp_path / "notes.txt" / "out"):
        pass
    with pytest.raises(OutputPlaceError, match="name too long"), whole_folder(tmp_path / ("a" * 300)):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_output_path_inside_a_file_ends_with_status_2(cut_scene: Path, tmp_path: Path) -> None:
    status, _, message = invoke("track", cut_scene, "--out", cut_scene / "out")
    assert status == 2
    assert message.startswith("diethrow: ")
    assert "Errno" not in message
