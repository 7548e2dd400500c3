"""A Dask cluster gives the same results as local processes: clips, counts, maps."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import CUBE_ON_WOOD, invoke
from throws import random_release, seen

from diethrow.files.throw_records import write_track
from diethrow.fitting.throw.physics import Physics
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL
from diethrow.model.throw.simulate import Until

pytest.importorskip("distributed")

SAMPLE = Path(__file__).parents[2] / "data_samples" / "cube_wood_photron"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler with one worker, both in separate processes, as on a real cluster."""
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    scheduler_words = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker_words = ["-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    named = ["--scheduler-file", str(file)]
    with (
        subprocess.Popen([sys.executable, *scheduler_words, *named], **quiet) as scheduler,  # type: ignore[call-overload]
        subprocess.Popen([sys.executable, *worker_words, *named], **quiet) as worker,  # type: ignore[call-overload]
    ):
        try:
            for _ in range(600):
                if file.exists() and file.stat().st_size:
                    break
                time.sleep(0.1)
            time.sleep(0.1)
            yield json.loads(file.read_text())["address"]
        finally:
            for process in (worker, scheduler):
                process.kill()  # at once: they would wait for each other


def test_odds_maps_and_clips_are_the_same_on_a_cluster(cluster: str, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    odds = ("odds", "--throws", "9000", "--chi", "0.3", "--after", "1", "--threads", "1")
    basins = ("basins", "--pixels", "40", "30", "--threads", "1")
    for words in (odds, basins):
        name = words[0]
        assert invoke(*words, "--out", here / name)[0] == 0
        status, _, notes = invoke(*words, "--out", there / name, "--scheduler", cluster)
        assert status == 0, notes
    assert (here / "odds" / "odds.csv").read_bytes() == (there / "odds" / "odds.csv").read_bytes()
    maps = [np.load(folder / "basins" / "basins.npz") for folder in (here, there)]
    for name in ("face", "impacts", "ending"):
        np.testing.assert_array_equal(maps[0][name], maps[1][name])
    for each in maps:
        each.close()

    scene = shutil.copytree(SAMPLE, tmp_path / "clip") / "scene.toml"
    track = ("--only-track", "--quality", "fast")
    assert invoke("track", scene, "--quality", "fast", "--out", here / "clip")[0] == 0
    status, _, notes = invoke("batch", scene, *track, "--out", there / "clips", "--scheduler", cluster)
    assert status == 0, notes
    for name in ("track.csv", "track_covariance.npy", "bounces.csv"):
        assert (here / "clip" / name).read_bytes() == (there / "clips" / "clip" / name).read_bytes()


def test_a_joint_fit_is_the_same_on_a_cluster(cluster: str, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(f"[clip]\nfps = 1500.0\n{CUBE_ON_WOOD}")
    die, random = make_die("cube", 0.016, 0.0048), np.random.default_rng(2)
    tracks = [tmp_path / f"throw_{k}.csv" for k in range(2)]
    for path in tracks:
        throw = Physics(die, LEVEL, {"chi": 0.6}).throw(random_release(die, random), Until(time_s=0.12)).throw
        write_track(path, seen(throw, random, noise=0.05))
    words = ("fit", *tracks, "--scene", tmp_path / "scene.toml", "--threads", "1")
    for out, more in (("here", ()), ("there", ("--scheduler", cluster))):
        status, _, notes = invoke(*words, "--out", tmp_path / out, *more)
        assert status == 0, notes
    assert (tmp_path / "here" / "fit.json").read_bytes() == (tmp_path / "there" / "fit.json").read_bytes()


def test_a_missing_scheduler_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.executors.ANSWER_S", 0.5)
    status, _, notes = invoke("odds", "--out", tmp_path / "out", "--throws", "10", "--scheduler", "tcp://127.0.0.1:9")
    assert status == 1
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in notes
    assert os.listdir(tmp_path) == []
