"""`diethrow lyapunov`, and the verdict of `diethrow throw` on decidability in double precision."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import CUBE, LAW, RELEASE, invoke, text_file

from diethrow.files.plan import read_plan
from diethrow.model.throw import throw_die

FEW = ("--impacts", "400", "--orbits", "2", "--leave-out", "50")


def test_an_exponent_is_written_with_its_errors_and_a_figure(tmp_path: Path) -> None:
    status, message, _ = invoke("lyapunov", *FEW, "--out", tmp_path / "out")
    assert status == 0
    assert "per second" in message
    assert {f.name for f in (tmp_path / "out").iterdir()} == {"lyapunov.json", "lyapunov.png", "provenance.json"}
    written = json.loads((tmp_path / "out" / "lyapunov.json").read_text())["exponent"]
    for unit in ("per_second", "per_impact", "per_sqrt_edge_over_g"):
        assert written[unit]["value"] > 3 * written[unit]["standard_error"] > 0
    assert (written["orbits"], written["impacts"], len(written["per_second_of_orbits"])) == (2, 400, 2)
    again = tmp_path / "again"
    invoke("lyapunov", *FEW, "--out", again)
    assert json.loads((again / "lyapunov.json").read_text())["exponent"] == written


def test_a_motion_that_ends_has_a_growth_and_no_exponent(tmp_path: Path) -> None:
    status, message, _ = invoke("lyapunov", "--chi", "0.5", "--out", tmp_path / "out")
    assert status == 0
    assert "no Lyapunov exponent" in message
    written = json.loads((tmp_path / "out" / "lyapunov.json").read_text())
    assert written["exponent"] is None
    assert len(written["growth"]["log10_at_impacts"]) == len(written["growth"]["times_s"]) > 3


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--chi", "1.5"), "chi = 1.5"),
        (("--orbits", "0"), "orbits 0"),
        (("--position", "0", "0", "0"), "below the table"),
        (("--amplitude", "-1"), "amplitude_m = -1"),
    ],
)
def test_impossible_starts_are_refused_in_one_sentence(options, sentence, tmp_path: Path) -> None:
    status, _, written = invoke("lyapunov", *options, "--out", tmp_path / "out")
    assert status == 2
    assert sentence in written
    assert not (tmp_path / "out").exists()


def test_a_throw_states_whether_it_is_decidable_in_double_precision(tmp_path: Path) -> None:
    plan = text_file(tmp_path / "throw.toml", CUBE + LAW + RELEASE)
    assert invoke("throw", plan, "--out", tmp_path / "out")[0] == 0
    written = json.loads((tmp_path / "out" / "throw.json").read_text())
    assert written["decidable"] is True
    assert written["error_growth"] > 1.0
    assert 0.0 < written["error_m"] < 1e-4
    assert written["margin"] > 1.0


def test_a_throw_in_air_lands_as_the_model_says_and_leaves_its_decidability_open(tmp_path: Path) -> None:
    plan = text_file(tmp_path / "throw.toml", CUBE + LAW + RELEASE + "\n[world]\ndrag_per_m = 0.5\n")
    assert invoke("throw", plan, "--out", tmp_path / "out")[0] == 0
    written, read = json.loads((tmp_path / "out" / "throw.json").read_text()), read_plan(plan)
    result = throw_die(read.die, read.release, read.law, drag_per_m=0.5)
    assert written["landed_face"] == result.landed_face
    assert written["end"]["t_s"] == result.end.time_s
    assert written["decidable"] is None
    assert any("it is computed for throws in vacuum" in sentence for sentence in written["messages"])
