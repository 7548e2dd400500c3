"""A run can be repeated from the provenance of its results; the results are compared number by number."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from command_line import invoke

from diethrow.commands.results.folder_comparison import compare

SAMPLE = Path(__file__).parents[2] / "data_samples"


@pytest.fixture
def thrown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A throw simulated with relative paths; afterwards the working folder is another one."""
    shutil.copy(SAMPLE / "throws" / "cube_mirror.toml", tmp_path / "throw.toml")
    monkeypatch.chdir(tmp_path)
    assert invoke("throw", "throw.toml", "--out", "out")[0] == 0
    monkeypatch.chdir(tmp_path.parent)
    return tmp_path / "out"


def test_the_numbers_of_a_repeated_run_agree_bit_for_bit(thrown: Path) -> None:
    before = sorted(thrown.parent.iterdir())
    status, said, _ = invoke("rerun", thrown)
    assert status == 0
    assert "agree bit for bit, in all 4 files" in said
    assert sorted(thrown.parent.iterdir()) == before


def test_the_output_may_be_one_word_and_no_scheduler_is_called(thrown: Path) -> None:
    origin = thrown / "provenance.json"
    contents = json.loads(origin.read_text())
    for scheduler in (["--scheduler", "tcp://192.0.2.1:8786"], ["--scheduler=tcp://192.0.2.1:8786"]):
        command = ["diethrow", "throw", "throw.toml", "--out=out", *scheduler]
        origin.write_text(json.dumps({**contents, "command": command}))
        # `throw` has no scheduler: were the words left in, it would refuse them.
        status, said, _ = invoke("rerun", thrown)
        assert status == 0
        assert "agree bit for bit" in said


def test_the_options_of_another_machine_are_used_only_when_accepted(thrown: Path) -> None:
    origin = thrown / "provenance.json"
    contents = json.loads(origin.read_text())
    elsewhere = {**contents, "made_on": "0" * 16}
    origin.write_text(json.dumps(elsewhere))
    # Without options there is nothing to ask.
    assert invoke("rerun", thrown)[0] == 0
    command = ["diethrow", "throw", "throw.toml", "--embed-replay", "--out", "out"]
    origin.write_text(json.dumps({**elsewhere, "command": command}))
    status, _, complaint = invoke("rerun", thrown)
    assert status == 1
    assert "another machine or by another user, with --embed-replay; nothing was run: give --yes" in complaint
    assert invoke("rerun", thrown, "--yes")[0] == 0


def test_numbers_that_differ_are_named_with_their_difference(thrown: Path) -> None:
    table = thrown / "bounces.csv"
    header, first, *rest = table.read_text().splitlines()
    cells = first.split(",")
    cells[1] = repr(float(cells[1]) * (1 + 1e-9))
    table.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    status, said, _ = invoke("rerun", thrown)
    assert status == 0
    assert "bounces.csv: t_s was" in said
    assert "agree within 1e-06; 3 of 4 files bit for bit" in said
    status, said, _ = invoke("rerun", thrown, "--within", "0")
    assert status == 1
    assert "do not agree within 0" in said


def test_an_input_that_changed_or_is_missing_is_an_error(thrown: Path) -> None:
    plan = thrown.parent / "throw.toml"
    kept = plan.read_bytes()
    plan.write_bytes(kept + b"\n# a word more\n")
    status, _, said = invoke("rerun", thrown)
    assert status == 1
    assert "throw.toml has changed since" in said
    plan.unlink()
    assert "throw.toml is missing" in invoke("rerun", thrown)[2]
    origin = thrown / "provenance.json"
    contents = json.loads(origin.read_text())
    origin.write_text(json.dumps({**contents, "command": [], "inputs": []}))
    assert "names no command that can be repeated" in invoke("rerun", thrown)[2]
    os.remove(origin)
    status, _, said = invoke("rerun", thrown)
    assert (status, len(said.splitlines())) == (1, 1)


def test_tables_are_compared_by_columns_and_json_by_keys(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    for folder, value, word in ((old, 1.0, "vertex"), (new, 1.1, "edge")):
        folder.mkdir()
        (folder / "a.csv").write_text(f"t_s,contact\n10.0,vertex\n{value},{word}\n")
        (folder / "b.json").write_text(
            json.dumps({"parameters": {"chi": {"value": value, "low": None}}, "list": [1, 2]})
        )
        (folder / "c.csv").write_text("same\n1\n")
    (new / "d.csv").write_text("more\n")
    (old / "e.csv").write_text("")
    (new / "e.csv").write_text("t_s\n1.0\n")
    same, differences = compare(old, new)
    assert same == ("c.csv",)
    found = {(each.file, each.column): each.share for each in differences}
    assert found[("a.csv", "t_s")] == pytest.approx(0.01)
    assert found[("a.csv", "contact")] == float("inf")
    assert found[("b.json", "parameters.chi.value")] == pytest.approx(0.1 / 1.1)
    assert found[("d.csv", "the file")] == float("inf")
    assert found[("e.csv", "t_s")] == float("inf")
    assert len(found) == 5
