"""`diethrow odds` and `diethrow basins`: their outputs, resumed runs, and refused options."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import invoke
from matplotlib.figure import Figure
from skimage.color import deltaE_ciede2000, rgb2lab

from diethrow.commands.model.basin_maps import BasinsPlan, axes_of, basins, fixed_from
from diethrow.commands.model.face_odds import OddsPlan, odds
from diethrow.files.work_file import WorkFile
from diethrow.model.die import make_die
from diethrow.model.ensembles.basins import Axis
from diethrow.model.ensembles.landings import ENDING_OF_INDEX, ThrowSetup
from diethrow.model.ensembles.odds import Share, Tally
from diethrow.model.ensembles.releases import drawn_states
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.simulate import Ending
from diethrow.replay.elements.colours import BOUNCING_COLOUR, FACE_COLOURS, NO_RELEASE_COLOUR, SPINNING_COLOUR
from diethrow.replay.figures.ensembles import basin_map, colours_of, face_odds

CUBE = make_die("cube", 0.02, 0.016)
PLAN = OddsPlan(CUBE, (0.5, 0.2), 40.0, throws=500, after=2)
SMALL = BasinsPlan(Axis("z0", 0.1, 0.4, 20), Axis("omega_eta", 0.0, 50.0, 30))


class StopAt:
    """Ctrl-C after a given amount of work."""

    def __init__(self, done: int) -> None:
        self.done = done

    def __call__(self, stage: str, done: int, total: int) -> None:
        if done >= self.done:
            raise KeyboardInterrupt


def counts(tallies: tuple[Tally, ...]) -> list[list[int]]:
    return [[t.throws, t.impacts, *t.landed, *t.endings, *t.lowest.ravel(), *t.as_start, *t.as_landed] for t in tallies]


@pytest.mark.parametrize("command", ["odds", "basins"])
def test_each_command_explains_itself_with_an_example(command: str) -> None:
    status, text, _ = invoke(command, "--help")
    assert status == 0
    assert f"Example:  diethrow {command} " in text


def test_odds_are_written_whole_and_add_up(tmp_path: Path) -> None:
    out = tmp_path / "odds"
    words = ("--chi", 0.5, "--chi", 0.2, "--throws", 300, "--after", 1, "--threads", 2, "--seed", 5, "--out", out)
    status, message, notes = invoke("odds", *words)
    assert status == 0, notes
    assert message.startswith("χ 0.5: faces ")
    assert {file.name for file in out.iterdir()} == {"odds.json", "odds.csv", "odds.png", "provenance.json"}
    assert [file.name for file in tmp_path.iterdir()] == ["odds"]
    written = json.loads((out / "odds.json").read_text())
    assert [series["chi"] for series in written["series"]] == [0.5, 0.2]
    for series in written["series"]:
        landed = sum(face["count"] for face in series["landed"])
        assert sum(ending["count"] for ending in series["endings"].values()) == series["throws"] == 300
        assert series["endings"]["rested"]["count"] == landed
        for impact in series["at_impact"]:
            assert sum(face["count"] for face in impact["lowest"]) == 300
        first = series["landed"][0]
        assert (first["low"], first["high"]) == Share(first["count"], 300).interval
    with (out / "odds.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_face = [int(row["count"]) for row in rows if row["quantity"] == "landed" and row["chi"] == "0.2"]
    assert by_face == [face["count"] for face in written["series"][1]["landed"]]
    origin = json.loads((out / "provenance.json").read_text())
    assert origin["seeds"] == {"throws": 5}
    assert origin["understood"]["throws"] == 300


def test_throws_that_land_on_no_face_are_reported(tmp_path: Path) -> None:
    plan = OddsPlan(CUBE, (1.0,), 40.0, conditions="uniform", throws=20, after=0)
    (tally,) = odds(plan, tmp_path / "out")
    written = json.loads((tmp_path / "out" / "odds.json").read_text())
    assert written["messages"] == ["20 of 20 throws landed on no face: 20 bouncing."]
    assert written["series"][0]["endings"]["bouncing"]["share"] == 1.0
    assert written["series"][0]["landed"][0]["of_landed"]["share"] is None
    assert tally.rested == 0


def test_resumed_odds_have_the_same_counts(tmp_path: Path) -> None:
    whole = odds(PLAN, tmp_path / "whole", chunk=100)
    # Once in the first series and once in the second.
    for stop in (200, 700):
        with pytest.raises(KeyboardInterrupt):
            odds(PLAN, tmp_path / "out", resume=True, chunk=100, progress=StopAt(stop))
        assert not (tmp_path / "out").exists()
        assert (tmp_path / ".out.work.npz").exists()
    began: list[int] = []
    again = odds(
        PLAN, tmp_path / "out", resume=True, chunk=130, threads=2, progress=lambda _, done, __: began.append(done)
    )
    assert min(done for done in began if done > 500) >= 700
    assert counts(again) == counts(whole)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["out", "whole"]


def test_a_resumed_map_has_the_same_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.commands.model.basin_maps.CHUNK_PIXELS", 80)
    whole, _ = basins(SMALL, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        basins(SMALL, tmp_path / "out", progress=StopAt(12))
    began: list[int] = []
    again, _ = basins(SMALL, tmp_path / "out", resume=True, threads=3, progress=lambda _, done, __: began.append(done))
    assert began[0] == 16
    for name in ("face", "impacts", "ending"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))


def test_a_map_is_kept_if_its_predictability_is_interrupted(tmp_path: Path) -> None:
    plan = replace(SMALL, predictability=True, conditions=32)

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "Disturbing":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        basins(plan, tmp_path / "out", progress=stop)
    stages: list[str] = []
    basins(plan, tmp_path / "out", resume=True, progress=lambda stage, _, __: stages.append(stage))
    assert "Mapping" not in stages
    assert [file.name for file in tmp_path.iterdir()] == ["out"]


def test_ctrl_c_says_how_to_resume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("diethrow.commands.model.face_odds.tally_throws", stopped)
    status, _, message = invoke("odds", "--out", tmp_path / "out")
    assert status == 130
    assert "--resume" in message
    assert list(tmp_path.iterdir()) == []


def test_a_work_file_with_other_settings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        odds(PLAN, tmp_path / "out", chunk=100, progress=StopAt(200))
    other = OddsPlan(CUBE, (0.5, 0.2), 41.0, throws=500, after=2)
    with pytest.raises(ValueError, match="belongs to a run with other settings"):
        odds(other, tmp_path / "out", resume=True)
    # Without --resume it is begun anew, and the old work file goes.
    odds(other, tmp_path / "out")
    assert [file.name for file in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"no archive"])
def test_an_invalid_work_file_is_an_error_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    work = WorkFile(tmp_path / "out", PLAN)
    work.path.write_bytes(content)
    with pytest.raises(ValueError, match="not a work file"):
        work.read()


def test_a_work_file_is_written_at_intervals_and_replaced_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = WorkFile(tmp_path / "out", PLAN)
    with work.keeping() as keep:
        keep({"a": np.arange(3)})
    assert work.read() is None  # nothing went wrong, and it was not yet time
    monkeypatch.setattr("diethrow.files.work_file.WRITE_INTERVAL_S", 0.0)
    with work.keeping() as keep:
        for k in range(3):
            keep({"a": np.arange(k)})
            kept = work.read()
            assert kept is not None
            assert len(kept["a"]) <= k
    assert [file.name for file in tmp_path.iterdir()] == [work.path.name]


def test_a_basin_is_written_whole(tmp_path: Path) -> None:
    out = tmp_path / "basins"
    words = ("--pixels", 20, 30, "--chi", 0.2, "--zoom", 0.2, 0.3, 10, 20, "--out", out)
    status, message, notes = invoke("basins", *words)
    assert status == 0, notes
    assert message.startswith("600 throws: faces ")
    assert {f.name for f in out.iterdir()} == {
        "basins.json",
        "basins.npz",
        "basins.png",
        "pixels.png",
        "provenance.json",
    }
    written = json.loads((out / "basins.json").read_text())
    assert written["x"] == {"name": "z0", "low": 0.2, "high": 0.3, "pixels": 20}
    assert written["fixed"] == {"psi": 0.3, "theta": 1.2, "phi": 0.6}
    assert sum(face["share"] for face in written["area"]["faces"]) + written["area"]["no_face"] == pytest.approx(1.0)
    with np.load(out / "basins.npz") as data:
        face, ending, y = data["face"], data["ending"], data["y"]
        assert data["endings"][0] == "rested"
    assert face.shape == (30, 20)
    assert np.all(np.diff(y) > 0)
    pixels = cv2.imread(str(out / "pixels.png"))
    assert pixels is not None
    # The picture's first row is the highest y.
    np.testing.assert_array_equal(pixels[::-1, :, ::-1], colours_of(face, ending))


def test_predictability_is_measured_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.commands.model.basin_maps.BALL_THROWS", 60)
    words = ("--pixels", 5, 5, "--chi", 0.05, "--predictability", "--samples", 200, "--out", tmp_path / "out")
    status, message, notes = invoke("basins", *words)
    assert status == 0, notes
    assert "decided at a distance of" in message
    assert (tmp_path / "out" / "predictability.png").exists()
    written = json.loads((tmp_path / "out" / "basins.json").read_text())["predictability"]
    assert written["conditions"] == 224  # 200, in 32 equal groups
    shares = [each["share"] for each in written["uncertain"]]
    # Few impacts: nothing uncertain at the smallest distance, most at the largest.
    assert shares[0] == 0.0
    assert shares[-1] > 0.3
    smallest = written["fair_by_dynamics"][0]
    assert smallest["one_face_alone"] == smallest["balls"] == 12
    assert smallest["not_refuted"] == 0
    assert all(sum(radius["counts"]) + radius["no_face"] == 60 for ball in written["balls"] for radius in ball["radii"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("odds", "--chi", 1.5), "chi = 1.5: wanted a coefficient of restitution"),
        (("odds", "--throws", 0), "wanted 1 throw or more"),
        (("odds", "--height", 0.001, 0.2), "could begin below the table"),
        (("odds", "--omega", "nan"), "wanted finite numbers"),
        (("odds", "--mu", -1), "mu = -1.0: wanted a coefficient of friction"),
        (("odds", "--drag", -1), "drag_per_m = -1.0: wanted 0 to 1000"),
        (("basins", "--drag", "nan"), "drag_per_m = nan: wanted 0 to 1000"),
        (("basins", "--x", "z", 0, 1), "axis 'z': wanted one of z0"),
        (("basins", "--zoom", 0.3, 0.2, 0, 1), "the lower one first"),
        (("basins", "--fix", "theta:1"), "wanted NAME=VALUE"),
        (("basins", "--fix", "tetha=1"), "fixed condition 'tetha'"),
        (("basins", "--at-impact", 0), "wanted a number from 1 to 1000"),
    ],
)
def test_impossible_options_give_one_sentence_and_no_folder(
    words: tuple[object, ...], message: str, tmp_path: Path
) -> None:
    status, _, written = invoke(*words, "--out", tmp_path / "out")
    assert status == 2
    assert message in written
    assert len(written.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_odds_and_basins_in_air_are_those_of_the_model_in_air(tmp_path: Path) -> None:
    words = ("--chi", 0.5, "--drag", 0.5, "--threads", 1)
    assert invoke("odds", *words, "--throws", 200, "--out", tmp_path / "odds")[0] == 0
    (series,) = json.loads((tmp_path / "odds" / "odds.json").read_text())["series"]
    assert series["drag_per_m"] == 0.5
    plan = OddsPlan(CUBE, (0.5,), 40.0, throws=200, drag_per_m=0.5)
    states = drawn_states(plan.drawn, CUBE, plan.seed, 0, 200)
    faces = ThrowSetup(CUBE, SmoothImpact(0.5), drag_per_m=0.5).throw(states).face
    assert [face["count"] for face in series["landed"]] == np.bincount(faces, minlength=7)[1:].tolist()
    assert invoke("basins", *words, "--pixels", 5, 4, "--out", tmp_path / "basins")[0] == 0
    assert json.loads((tmp_path / "basins" / "basins.json").read_text())["drag_per_m"] == 0.5


def test_an_existing_folder_is_refused_before_any_throw(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    status, _, message = invoke("odds", "--throws", 10**12, "--out", tmp_path / "out")
    assert status == 2
    assert "--force" in message


def test_axes_and_fixed_conditions_are_read_from_words() -> None:
    x, y = axes_of(("psi", 0.0, 6.0), ("vx", -1.0, 1.0), (1.0, 2.0, 0.0, 0.5), (10, 20))
    assert (x, y) == (Axis("psi", 1.0, 2.0, 10), Axis("vx", 0.0, 0.5, 20))
    assert fixed_from(["theta=2", "vz=-0.7"]) == {"z0": 0.3, "psi": 0.3, "theta": 2.0, "phi": 0.6, "vz": -0.7}


def test_colours_of_faces_differ_for_the_colour_blind() -> None:
    # Machado, Oliveira and Fernandes (2009), severity 1: protan, deutan, tritan.
    sights = [
        np.eye(3),
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    ]
    encoded = np.array(FACE_COLOURS) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    for sight in sights:
        seen = np.clip(linear @ np.array(sight).T, 0.0, 1.0)
        shown = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
        lab = rgb2lab(shown)
        apart = deltaE_ciede2000(lab[:, None], lab[None]) + 100.0 * np.eye(len(lab))
        for faces, least in ((4, 19.9), (12, 12.0), (20, 9.3)):
            assert apart[:faces, :faces].min() >= least


def test_endings_on_no_face_have_their_own_colours() -> None:
    spins, bounces = (ENDING_OF_INDEX.index(ending) for ending in (Ending.SPINNING, Ending.BOUNCING))
    colours = colours_of(np.array([1, 0, 0, 0, 20]), np.array([0, spins, bounces, -1, 0]))
    assert colours.tolist() == [
        list(c) for c in (FACE_COLOURS[0], SPINNING_COLOUR, BOUNCING_COLOUR, NO_RELEASE_COLOUR, FACE_COLOURS[19])
    ]


def test_figures_state_units_and_name_every_face() -> None:
    face, ending = np.array([[1, 2], [0, 4]]), np.array([[0, 0], [ENDING_OF_INDEX.index(Ending.SPINNING), 0]])
    ax = basin_map(Figure().add_subplot(), SMALL.x, SMALL.y, face, ending, 4)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$z_0$ [m]", r"$\omega_\eta$ [rad/s]")
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["face 1", "face 2", "face 3", "face 4", "spins"]
    bars = face_odds(Figure().add_subplot(), {"χ = 0.5": [Share(10, 60)] * 6})
    assert "[" in bars.get_ylabel()


def test_a_die_of_any_shape_is_thrown_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "d10.toml"
    file.write_text('[die]\nshape = "d10"\nedge_m = 0.0145\nshort_edge_m = 0.0078\nmass_kg = 0.0035\n')
    status, _, message = invoke(
        "odds", "--die", file, "--throws", "200", "--conditions", "uniform", "--out", tmp_path / "out"
    )
    assert status == 0, message
    record = json.loads((tmp_path / "out" / "odds.json").read_text())
    assert record["die"] == {"shape": "d10", "edge_m": 0.0145, "short_edge_m": 0.0078, "mass_kg": 0.0035}
    faces = record["series"][0]["landed"]
    assert len(faces) == 10
    origin = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert [Path(each["path"]).name for each in origin["inputs"]] == ["d10.toml"]


def test_a_die_from_a_file_has_no_second_shape(tmp_path: Path) -> None:
    file = tmp_path / "cube.toml"
    file.write_text('[die]\nshape = "cube"\nedge_m = 0.02\nmass_kg = 0.016\n')
    status, _, message = invoke("odds", "--die", file, "--edge", "0.01", "--out", tmp_path / "out")
    assert status == 2
    assert "--edge beside --die" in message


D10 = '[die]\nshape = "d10"\nedge_m = 0.0145\nshort_edge_m = 0.0078\nmass_kg = 0.0035\n'


def test_a_die_of_any_shape_is_thrown_to_its_rest(tmp_path: Path) -> None:
    release = (
        "[initial]\nposition_m = [0.0, 0.0, 0.08]\nquaternion_wxyz = [0.6, 0.0, 0.8, 0.0]\nvelocity_m_s = [0.1, 0.0, -0.5]\n"
        "omega_rad_s = [9.0, -14.0, 6.0]\n"
    )
    file = tmp_path / "throw.toml"
    file.write_text(f"{D10}[law]\nchi = 0.5\n{release}")
    status, _, message = invoke("throw", file, "--out", tmp_path / "out")
    assert status == 0, message
    record = json.loads((tmp_path / "out" / "throw.json").read_text())
    assert record["landed_face"] in range(1, 11)
    assert record["decidable"] is None
    assert any("one moment of inertia" in sentence for sentence in record["messages"])


def test_exponents_of_a_die_with_several_moments_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "d10.toml"
    file.write_text(D10)
    status, _, message = invoke("lyapunov", "--die", file, "--out", tmp_path / "out")
    assert status == 2
    assert "a d10: wanted a die with one moment of inertia" in message
