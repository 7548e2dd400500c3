"""The command line answers at once, computes what it is asked for, and fails in one sentence."""

from __future__ import annotations

import csv
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import CUBE, CUBE_ON_WOOD, LAW, RELEASE, SMALL_CAMERA, empty_table, invoke, text_file

import diethrow
import diethrow.commands.clip.analyze
from diethrow.files.plan import read_plan
from diethrow.files.scene import read_scene
from diethrow.files.throw_records import read_bounces, read_simulated, simulated_track, write_track
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.track import TRACKED, Track

FIT_SCENE = f"[clip]\nfps = 1500.0\n{CUBE_ON_WOOD}"


@pytest.fixture
def throw_plan(tmp_path: Path) -> Path:
    return text_file(tmp_path / "throw.toml", f"{CUBE}{LAW}{RELEASE}[until]\nimpacts = 3\n")


@pytest.fixture
def empty_scene(tmp_path: Path) -> Path:
    """Thirty frames of an empty table: sensor noise, and no die."""
    background, frames = empty_table(3)
    (tmp_path / "frames").mkdir()
    for k, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / "frames" / f"f_{k:03d}.png"), frame)
    cv2.imwrite(str(tmp_path / "background.png"), background)
    clip = '[clip]\npath = "frames"\nfps = 1500.0\nbackground = "background.png"\n'
    return text_file(tmp_path / "scene.toml", clip + SMALL_CAMERA + CUBE_ON_WOOD)


def test_help_imports_no_numerical_library() -> None:
    heavy = ["numpy", "scipy", "numba", "cv2", "av", "rerun", "matplotlib", "pandas", "pydantic", "rich"]
    script = f"import sys, diethrow, diethrow.cli; print([name for name in {heavy} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


def test_version_is_printed() -> None:
    assert invoke("--version")[:2] == (0, f"diethrow {diethrow.__version__}\n")


@pytest.mark.parametrize("command", ["analyze", "track", "fit", "throw", "calibrate", "check"])
def test_every_command_has_help_with_an_example(command: str) -> None:
    status, text, _ = invoke(command, "--help")
    assert status == 0
    assert "--out" in text
    assert f"Example:  diethrow {command} " in text


def test_public_names_exist_and_others_raise() -> None:
    for name in diethrow.__all__:
        assert getattr(diethrow, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'thorw'"):
        diethrow.thorw  # noqa: B018


def test_a_missing_option_ends_with_status_2(tmp_path: Path) -> None:
    status, _, message = invoke("analyze", tmp_path / "scene.toml")
    assert status == 2
    assert "--out" in message


def test_throw_writes_what_the_model_computes(throw_plan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    status, message, _ = invoke("throw", throw_plan, "--out", out)
    assert status == 0
    assert message.startswith("3 impacts")
    names = {
        "throw.json",
        "bounces.csv",
        "simulated.csv",
        "vertices.csv",
        "heights.png",
        "replay.rrd",
        "provenance.json",
    }
    assert {file.name for file in out.iterdir()} == names
    plan = read_plan(throw_plan)
    expected = throw_die(plan.die, plan.release, SmoothImpact(0.5), until=Until(impacts=3))
    assert [i.time_s for i in read_bounces(out / "bounces.csv")] == [i.time_s for i in expected.throw.impacts]
    poses = read_simulated(out / "simulated.csv")
    np.testing.assert_array_equal(poses.position_m, expected.throw.poses(np.arange(len(poses)) / 1500.0)[0])
    written = json.loads((out / "throw.json").read_text())
    assert (written["impact_count"], written["ending"], written["decidable"]) == (3, "impacts_reached", None)
    assert written["end"]["position_m"] == expected.end.position_m.tolist()
    assert all(isinstance(message, str) for message in written["messages"])


def test_provenance_names_the_inputs_by_their_bytes(throw_plan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    invoke("throw", throw_plan, "--out", out)
    origin = json.loads((out / "provenance.json").read_text())
    assert origin["diethrow"] == diethrow.__version__
    assert origin["command"] == ["diethrow", "throw", str(throw_plan), "--out", str(out)]
    digest = hashlib.sha256(throw_plan.read_bytes()).hexdigest()
    assert origin["inputs"] == [{"path": str(throw_plan), "bytes": throw_plan.stat().st_size, "sha256": digest}]
    assert origin["understood"]["chi"] == 0.5
    assert origin["understood"]["text"] == throw_plan.read_text()
    assert set(origin["timings_s"]) == {"throw", "records", "figure", "replay"}
    assert origin["packages"]["numpy"] == np.__version__


def test_an_existing_folder_is_refused_with_status_2_and_replaced_by_force(throw_plan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    status, _, message = invoke("throw", throw_plan, "--out", out)
    assert status == 2
    assert "--force" in message
    assert [file.name for file in out.iterdir()] == ["mine.txt"]
    assert invoke("throw", throw_plan, "--out", out, "--force")[0] == 0
    assert (out / "throw.json").exists()
    assert not (out / "mine.txt").exists()


def test_a_clip_without_a_die_ends_in_one_sentence_and_no_folder(empty_scene: Path, tmp_path: Path) -> None:
    for command in ("analyze", "track"):
        status, _, message = invoke(command, empty_scene, "--out", tmp_path / "out")
        assert status == 1
        assert message.startswith(f"diethrow: {empty_scene}: no die was found in")
        assert len(message.splitlines()) == 1
        assert not (tmp_path / "out").exists()


def test_a_background_of_another_size_is_one_sentence(empty_scene: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "background.png"), np.zeros((32, 96), np.uint8))
    status, _, message = invoke("analyze", empty_scene, "--out", tmp_path / "out")
    assert status == 2
    for words in ("clip.background = background.png", "96 × 32", "96 × 64"):
        assert words in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("line", "changed", "named"),
    [("width = 96", "width = 97", "camera.width and camera.height = [97, 64]"), ("fps = 1500.0\n", "", "fps")],
    ids=["another camera", "no frame rate"],
)
def test_a_scene_that_the_clip_does_not_allow_is_one_sentence(
    empty_scene: Path, tmp_path: Path, line: str, changed: str, named: str
) -> None:
    empty_scene.write_text(empty_scene.read_text().replace(line, changed))
    status, _, message = invoke("analyze", empty_scene, "--out", tmp_path / "out")
    assert status == 2
    assert named in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    "content", [b"", b"\0" * 5000, b"RIFF\xff\xff\xff\xffAVI LIST" + b"\x07" * 3000, b"a film, I swear"]
)
def test_a_damaged_clip_is_one_sentence(empty_scene: Path, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "clip.avi").write_bytes(content)
    empty_scene.write_text(empty_scene.read_text().replace('path = "frames"', 'path = "clip.avi"'))
    status, _, message = invoke("analyze", empty_scene, "--out", tmp_path / "out")
    assert status == 2
    assert message.startswith(f"diethrow: {empty_scene}: clip.path = clip.avi: ")
    assert len(message.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_stopped_run_leaves_no_folder(empty_scene: Path, tmp_path: Path) -> None:
    def stop(stage: str, done: int, total: int) -> None:
        if done > 3:
            raise KeyboardInterrupt

    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(KeyboardInterrupt):
        diethrow.commands.clip.analyze.analyze(read_scene(empty_scene), tmp_path / "out", progress=stop)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("met", ["python", "a kernel", "the compiler"])
def test_ctrl_c_ends_with_status_130(
    empty_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, met: str
) -> None:
    def stopped(*_: object, **__: object) -> None:
        # As numba was seen to pass it on.
        if met == "the compiler":
            raise RuntimeError("no compiled object yet for <Library 'score_many' at 0x7f3fc8fdced0>")
        if met == "a kernel":
            inner = SystemError("returned a result with an exception set")
            inner.__cause__ = KeyboardInterrupt()
            raise SystemError("returned a result with an exception set") from inner
        raise KeyboardInterrupt

    monkeypatch.setattr("diethrow.commands.clip.track.track_clip_in_time", stopped)
    before = sorted(tmp_path.rglob("*"))
    status, _, message = invoke("analyze", empty_scene, "--out", tmp_path / "out")
    assert status == 130
    assert len(message.splitlines()) == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_fit_of_any_track_recovers_the_restitution(throw_plan: Path, tmp_path: Path) -> None:
    plan = read_plan(throw_plan)
    throw = throw_die(plan.die, plan.release, SmoothImpact(0.5), until=Until(impacts=3)).throw
    frame = np.arange(int(throw.flights[-1].end_s * 1500.0))
    exact = simulated_track(throw, frame, frame / 1500.0)
    # 10 µm and 0.5 mrad: a good tracker, so that the interval is some thousandths wide.
    sigmas = np.array([1e-5] * 3 + [5e-4] * 3)
    rng = np.random.default_rng(5)
    noisy = exact.position_m + rng.normal(0, 1e-5, exact.position_m.shape)
    turned = exact.quaternion + 0.5 * rng.normal(0, 5e-4, exact.quaternion.shape)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    covariance = np.tile(np.diag(sigmas**2), (len(frame), 1, 1))
    track = Track(frame, exact.time_s, noisy, turned, covariance, np.full(len(frame), TRACKED))
    write_track(tmp_path / "any.csv", track)
    scene = text_file(tmp_path / "scene.toml", FIT_SCENE)
    out = tmp_path / "out"
    status, message, notes = invoke("fit", tmp_path / "any.csv", "--scene", scene, "--out", out)
    assert status == 0, notes
    assert "restitution χ" in message
    fit = json.loads((out / "fit.json").read_text())
    chi = fit["parameters"]["chi"]
    # The interval holds the truth in 95 % of all cases; the seed is one of them, and the estimate is near in any case.
    assert chi["low"] <= 0.5 <= chi["high"]
    assert abs(chi["value"] - 0.5) < 0.01
    with (out / "simulated.csv").open(newline="") as file:
        assert len(list(csv.reader(file))) == len(frame) + 1
    names = {
        *("analysis.json", "fit.json", "provenance.json", "replay.rrd", "report.html", "simulated.csv"),
        *("vertices.csv", "faces.csv", "bounces.csv", "track.csv", "track_covariance.npy"),
        *("track_frames.csv", "track_frames_covariance.npy", "track_frames_throw.npz"),
    }
    assert {file.name for file in out.iterdir()} == names


def test_a_fit_of_a_table_without_poses_ends_with_status_1(tmp_path: Path) -> None:
    scene = text_file(tmp_path / "scene.toml", FIT_SCENE)
    (tmp_path / "any.csv").write_text("time,x\n0,1\n")
    status, _, message = invoke("fit", tmp_path / "any.csv", "--scene", scene, "--out", tmp_path / "out")
    assert status == 1
    assert "any.csv: column frame is missing" in message
    assert not (tmp_path / "out").exists()
