"""Several throws from the command line: found, distinguished, joined, and shown."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest
import replay_records as made
from rerun.chunk import RrdReader
from typer.testing import CliRunner

import diethrow.commands.results.viewer
from diethrow.cli.app import app
from diethrow.commands.results.joined_recordings import COLUMNS, find_recordings, join
from diethrow.commands.results.repeated_run import rerun
from diethrow.commands.results.viewer import DEAD_PROXY, TELEMETRY_VARIABLES, open_viewer, silent_environment
from diethrow.replay.recording.throw_recording import write_recording


def invoke(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["replay", *map(str, words)])
    assert "Traceback" not in result.output
    return result.exit_code, result.stdout, " ".join(result.stderr.split())


@pytest.fixture(scope="module")
def throws(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three analysed throws: two models of one clip, and another clip."""
    folder = tmp_path_factory.mktemp("throws")
    for name, shift_m, clip in (("a", 1e-5, "clip 1"), ("b", 5e-5, "clip 1"), ("c", 1e-5, "clip 2")):
        (folder / name).mkdir()
        record = made.record(title="a throw", clip=None, simulated=made.track(shift_m, gaps=False))
        write_recording(folder / name / "replay.rrd", record)
        inputs = [{"path": "clip.avi", "sha256": clip}, {"path": "scene.toml", "sha256": name}]
        (folder / name / "provenance.json").write_text(json.dumps({"inputs": inputs}))
    return folder


def test_a_folder_of_throws_stands_for_all_of_them(throws: Path) -> None:
    assert [one.name for one in find_recordings([throws])] == ["a", "b", "c"]
    assert [one.name for one in find_recordings([throws / "c", throws / "a" / "replay.rrd"])] == ["c", "a"]


def test_throws_of_one_name_are_distinguished_by_their_folders(throws: Path, tmp_path: Path) -> None:
    twin = tmp_path / "elsewhere" / "a"
    twin.mkdir(parents=True)
    (twin / "replay.rrd").write_bytes((throws / "a" / "replay.rrd").read_bytes())
    assert [one.name for one in find_recordings([throws / "a", twin])] == [f"{throws.name}_a", "elsewhere_a"]


def test_the_table_has_one_row_per_throw(throws: Path) -> None:
    status, message, _ = invoke(throws)
    assert status == 0
    assert "0.5831 (0.5802 to 0.5859)" in message
    assert message.count("1 of 1 bounce explained") == 3


def test_several_throws_go_into_one_recording(throws: Path, tmp_path: Path) -> None:
    out = tmp_path / "all.rrd"
    status, message, _ = invoke(throws, "--out", out)
    assert status == 0, message
    assert "3 throws in" in message
    there = {chunk.entity_path for chunk in RrdReader(out).stream()}
    assert {"/world/a/measured/die", "/world/b/measured/die", "/world/c/simulated/die"} <= there


def test_models_of_one_clip_are_recognised(throws: Path, tmp_path: Path) -> None:
    status, message, _ = invoke(throws / "a", throws / "b", "--out", tmp_path / "models.rrd")
    assert (status, "2 models of one throw" in message) == (0, True)
    status, message, _ = invoke(throws / "a", throws / "b", "--throws", "--out", tmp_path / "throws.rrd")
    assert (status, "2 throws in" in message) == (0, True)


def test_a_folder_gets_one_recording_per_throw_and_a_table(throws: Path, tmp_path: Path) -> None:
    out = tmp_path / "table"
    assert invoke(throws, "--out", out)[0] == 0
    files = ["a.rrd", "b.rrd", "c.rrd", "provenance.json", "throws.csv"]
    assert sorted(path.name for path in out.iterdir()) == files
    with (out / "throws.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["throw"] for row in rows] == ["a", "b", "c"]
    assert tuple(rows[0]) == ("throw", *COLUMNS)
    assert float(rows[0]["chi"]) == 0.5831
    applications = {RrdReader(out / f"{name}.rrd").recordings()[0].application_id for name in "abc"}
    assert applications == {"diethrow"}
    # Copies of one folder come from different clips all the same.
    status, message, _ = invoke(out, "--out", tmp_path / "again.rrd")
    assert (status, "3 throws in" in message) == (0, True)
    repeated = rerun(out)
    assert (repeated.same, repeated.differences) == (("throws.csv",), ())


def test_nothing_is_replaced_without_force(throws: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.rrd"
    out.write_text("mine")
    status, _, message = invoke(throws, "--out", out)
    assert (status, "exists" in message, out.read_text()) == (2, True, "mine")
    assert invoke(throws, "--out", out, "--force")[0] == 0
    status, _, message = invoke(throws, "--out", throws / "a" / "replay.rrd", "--force")
    assert status == 2
    assert "which must stay" in message


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("{throws}/none",), "no recording of a throw"),
        (("{throws}/a", "{throws}/a"), "given twice"),
        (("{throws}/a", "--out", "{tmp}/x.rrd"), "is one recording"),
    ],
)
def test_a_mistake_is_one_sentence(words: tuple[str, ...], sentence: str, throws: Path, tmp_path: Path) -> None:
    status, _, message = invoke(*(word.format(throws=throws, tmp=tmp_path) for word in words))
    assert status != 0
    assert sentence in message
    assert list(tmp_path.iterdir()) == []


def test_the_help_shows_examples() -> None:
    status, message, _ = invoke("--help")
    assert status == 0
    assert "diethrow replay out/cube_wood --open" in message


def test_throws_without_provenance_are_not_models_of_one(throws: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "replay.rrd").write_bytes((throws / name / "replay.rrd").read_bytes())
    assert not join(find_recordings([tmp_path]), tmp_path / "x.rrd", align="bounce", models=None)


def test_the_viewer_is_opened_on_loopback_without_statistics(throws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[list[str], dict[str, str]]] = []

    def run(command: list[str], *, env: dict[str, str], **_: object) -> subprocess.CompletedProcess[str]:
        asked.append((command, env))
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(diethrow.commands.results.viewer.subprocess, "run", run)
    monkeypatch.setenv(TELEMETRY_VARIABLES[0], "1")
    assert invoke(throws / "a", "--open")[0] == 0
    ((command, environment),) = asked
    assert command[0] == sys.executable
    assert command[-1] == str(throws / "a" / "replay.rrd")
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert TELEMETRY_VARIABLES[0] not in environment
    assert environment["HTTPS_PROXY"] == DEAD_PROXY
    assert environment["CI"] == "1"


def test_a_viewer_that_does_not_open_says_why(throws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = "import sys; print('no screen here', file=sys.stderr); sys.exit(3)"
    monkeypatch.setattr(diethrow.commands.results.viewer, "viewer_program", lambda: [sys.executable, "-c", script])
    with pytest.raises(OSError, match=r"status 3 \(no screen here\)"):
        open_viewer([throws / "a" / "replay.rrd"])
    with pytest.raises(FileNotFoundError, match="no such recording"):
        open_viewer([throws / "none.rrd"])


def test_the_environment_of_the_program_itself_is_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ANY_OTHER", "kept")
    assert silent_environment()["ANY_OTHER"] == "kept"
