"""Manners of the command line: choices, verbosity and JSON mean the same in every command."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import typer
from command_line import CUBE, LAW, RELEASE, invoke, text_file

import diethrow
from diethrow.cli.app import app
from diethrow.cli.errors import one_sentence_errors
from diethrow.files.outputs import OutputExistsError
from diethrow.model.errors import InputError

COMMANDS = sorted(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
WITHOUT_NUMBERS = {"film", "report"}
"""Commands that end with pictures."""


@pytest.fixture(autouse=True)
def usual_level() -> Iterator[None]:
    """The level of the log, which belongs to the process, as it was."""
    logger = logging.getLogger("diethrow")
    level = logger.level
    yield
    logger.setLevel(level)


@pytest.fixture
def throw_plan(tmp_path: Path) -> Path:
    return text_file(tmp_path / "throw.toml", f"{CUBE}{LAW}{RELEASE}[until]\nimpacts = 3\n")


@pytest.mark.parametrize("command", COMMANDS)
def test_the_short_and_the_long_option_for_help_say_the_same(command: str) -> None:
    short, long = (invoke(command, option) for option in ("-h", "--help"))
    assert short == long
    assert short[0] == 0


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_ends_with_numbers_prints_them_as_json_if_asked(command: str) -> None:
    assert ("--json" in invoke(command, "--help")[1]) is (command not in WITHOUT_NUMBERS)


@pytest.mark.parametrize(
    "words",
    [
        ("analyze", "scene.toml", "--quality", "best"),
        ("track", "scene.toml", "--quality", "best"),
        ("batch", "scene.toml", "--quality", "best"),
        ("analyze", "scene.toml", "--timing", "wrong"),
        ("check", "scene.toml", "--timing", "wrong"),
        ("batch", "scene.toml", "--intervals", "wide"),
        ("fit", "track.csv", "--scene", "scene.toml", "--intervals", "wide"),
        ("odds", "--conditions", "any"),
        ("odds", "--shape", "cone"),
        ("basins", "--shape", "cone"),
        ("calibrate", "board.png", "--square-mm", "10", "--board", "paper"),
        ("film", "throw.toml", "--codec", "gif"),
        ("replay", "scene.toml", "--align", "end"),
        ("analyze", "scene.toml", "--chi-within", "-1"),
        ("trade", "scene.toml", "--chi-within", "-1"),
        ("batch", "scene.toml", "--chi-within", "2"),
    ],
    ids=lambda words: " ".join(words[:1] + words[-2:]),
)
def test_a_wrong_value_of_an_option_ends_with_status_2_and_names_the_option(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    for name in ("scene.toml", "throw.toml"):
        text_file(tmp_path / name, SCENE if name == "scene.toml" else f"{CUBE}{LAW}{RELEASE}")
    (tmp_path / "clip.avi").touch()
    given = [str(tmp_path / word) if word.endswith(".toml") else word for word in words]
    status, _, message = invoke(*given, "--out", tmp_path / "out")
    assert status == 2
    assert words[-2] in message
    assert words[-1] in message
    assert not (tmp_path / "out").exists()


def test_a_batch_that_only_tracks_refuses_what_tracking_does_not_have(tmp_path: Path) -> None:
    words = ("batch", tmp_path / "scene.toml", "--only-track", "--intervals", "covariance", "--out", tmp_path / "out")
    status, _, message = invoke(*words)
    assert status == 2
    assert "--intervals beside --only-track" in message


SCENE = f"""[clip]
path = "clip.avi"
fps = 1500.0
[camera]
width = 96
height = 64
matrix = [[600.0, 0.0, 48.0], [0.0, 600.0, 32.0], [0.0, 0.0, 1.0]]
rotation = [[1.0, 0.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.8, -0.6]]
translation_m = [0.0, 0.02, 0.6]
[table]
surface = "wood"
{CUBE}"""


def test_json_is_all_that_is_printed_and_the_record_that_is_written(throw_plan: Path, tmp_path: Path) -> None:
    status, printed, _ = invoke("throw", throw_plan, "--out", tmp_path / "out", "--json")
    assert status == 0
    assert json.loads(printed) == json.loads((tmp_path / "out" / "throw.json").read_text(encoding="utf-8"))


def test_a_quiet_command_says_nothing_beside_its_result_and_a_verbose_one_names_its_stages(
    throw_plan: Path, tmp_path: Path
) -> None:
    quiet = invoke("-q", "throw", throw_plan, "--out", tmp_path / "quiet")
    verbose = invoke("-v", "throw", throw_plan, "--out", tmp_path / "verbose")
    assert quiet[2] == ""
    stages = [line.removeprefix("diethrow: ").split(":")[0] for line in verbose[2].splitlines()]
    assert stages[:2] == ["throw", "records"]
    assert quiet[1].splitlines()[0] == verbose[1].splitlines()[0]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("analyse",), "no such command 'analyse'; did you mean 'analyze'? (see diethrow --help)"),
        (("--fast",), "no such option: --fast (see diethrow --help)"),
        (("analyze", "scene.toml"), "missing option '--out' (see diethrow analyze --help)"),
        (("throw",), "missing argument 'THROW.toml' (see diethrow throw --help)"),
        (("-q", "-v", "throw", "a", "--out", "b"), "-v and -q: wanted one of the two (see diethrow --help)"),
    ],
)
def test_a_mistake_on_the_command_line_is_one_sentence(words: tuple[str, ...], sentence: str) -> None:
    run = subprocess.run([sys.executable, "-m", "diethrow", *words], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (2, "", f"diethrow: {sentence}\n")


def test_the_program_alone_shows_its_help() -> None:
    run = subprocess.run([sys.executable, "-m", "diethrow"], capture_output=True, text=True, check=False)
    assert "Commands:" in run.stdout + run.stderr


def test_quiet_and_verbose_exclude_each_other(throw_plan: Path, tmp_path: Path) -> None:
    status, _, message = invoke("-q", "-v", "throw", throw_plan, "--out", tmp_path / "out")
    assert status == 2
    assert "-v and -q" in message


def test_the_module_is_the_program() -> None:
    run = subprocess.run([sys.executable, "-m", "diethrow", "--version"], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("diethrow ")


def test_a_fault_of_the_program_does_not_pose_as_a_mistake_of_the_user(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="broadcast"), one_sentence_errors():
        np.ones(2) + np.ones(3)
    assert "a fault of the program, not of your input; please report" in capsys.readouterr().err
    with pytest.raises(typer.Exit), one_sentence_errors():
        raise InputError("three corners: wanted four")
    assert capsys.readouterr().err == "diethrow: three corners: wanted four\n"


def test_every_error_that_a_user_can_mend_has_one_base() -> None:
    assert issubclass(diethrow.SceneError, diethrow.DiethrowError)
    assert issubclass(diethrow.RunError, diethrow.DiethrowError)
    assert issubclass(OutputExistsError, diethrow.DiethrowError)
    with pytest.raises(diethrow.DiethrowError):
        diethrow.make_die("cube", -1.0, 1.0)
