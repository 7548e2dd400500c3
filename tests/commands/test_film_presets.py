"""Presets of films: each gives a clip that the program reads, several combine, and explicit options win."""

from __future__ import annotations

import csv
import dataclasses
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from command_line import CUBE, LAW, RELEASE, invoke, text_file
from film_studio import with_mitsuba

from diethrow.commands.clip.footage import open_footage
from diethrow.commands.model.film_presets import PRESETS, preset_rows, preset_values
from diethrow.commands.model.film_settings import FilmSettings, film_settings
from diethrow.commands.model.filmed_throw import film, film_job, scene_text
from diethrow.files.plan import read_plan
from diethrow.files.scene import read_scene
from diethrow.model.errors import InputError

TURNS = hasattr(av.VideoStream, "set_display_rotation")
"""Whether PyAV can write the rotation of an MP4; version 18 does."""
USABLE = [preset for preset in PRESETS if TURNS or "turned_deg" not in preset.values]
NAMES = [preset.name for preset in USABLE]
PLAN = f'[table]\nsurface = "cork"\n{CUBE}{LAW}{RELEASE}[until]\ntime_s = 0.05\n[output]\nfps = 1000.0\n'


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return text_file(tmp_path / "throw.toml", PLAN)


def columns(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


@with_mitsuba
@pytest.mark.parametrize("name", NAMES)
def test_each_preset_is_a_clip_with_its_truth(name: str, plan: Path, tmp_path: Path) -> None:
    settings = film_settings([name], frames=4, size_px=64, samples=1)
    job = film(read_plan(plan), tmp_path / "film", settings=settings)
    scene = read_scene(tmp_path / "film" / "scene.toml")
    clip = open_footage(scene, scene.views()[0])
    assert (clip.width_px, clip.height_px, len(clip)) == (64, 64, len(job.shown))
    assert scene.clip.exposure_s == job.exposure_s
    assert scene.clip.readout_s == job.readout_s
    assert scene.clip.response == job.response
    assert scene.die.corner_radius_m == job.die.corner_radius_m
    truth, frames = columns(tmp_path / "film" / "truth.csv"), columns(tmp_path / "film" / "frames.csv")
    assert len(truth["frame"]) == len(frames["frame"]) == len(clip)
    for k, picture in enumerate(frames["picture"]):
        assert float(truth["t"][k]) == pytest.approx(int(picture) / job.fps)
        position_m = [float(truth[axis][k]) for axis in "xyz"]
        assert position_m == pytest.approx(job.throw.at(int(picture) / job.fps).position_m, abs=1e-12)


@with_mitsuba
def test_faults_of_the_order_of_frames_are_those_of_the_truth(plan: Path, tmp_path: Path) -> None:
    """Without noise, a frame that is stored twice is the same picture, and a frozen one as well."""
    settings = film_settings(["doubled-frames", "frozen-frames"], frames=12, size_px=64, samples=1)
    job = film(read_plan(plan), tmp_path / "film", settings=settings)
    scene = read_scene(tmp_path / "film" / "scene.toml")
    clip = open_footage(scene, scene.views()[0])
    frames = list(clip.frames())
    repeated = [bool((a == b).all()) for a, b in pairwise(frames)]
    assert repeated == (np.diff(job.shown) == 0).tolist()
    named = columns(tmp_path / "film" / "frames.csv")["fault"]
    assert [fault == "repeated" for fault in named[1:]] == repeated


@with_mitsuba
def test_a_second_die_has_its_truth_and_stays_apart(plan: Path, tmp_path: Path) -> None:
    settings = film_settings(["second-die"], frames=3, size_px=64, samples=1)
    job = film(read_plan(plan), tmp_path / "film", settings=settings)
    assert job.second is not None
    times = np.linspace(0.0, 0.05, 40)
    apart = np.linalg.norm(job.throw.poses(times)[0] - job.second.poses(times)[0], axis=1)
    assert apart.min() > 2.0 * job.die.solid.circumradius
    rows = columns(tmp_path / "film" / "second_die.csv")
    assert [float(rows[axis][2]) for axis in "xyz"] == pytest.approx(job.second.at(2 / job.fps).position_m, abs=1e-12)


def test_presets_set_fields_that_exist_and_describe_themselves() -> None:
    known = {each.name for each in dataclasses.fields(FilmSettings)}
    assert len(set(NAMES)) == len(NAMES)
    for preset in USABLE:
        assert set(preset.values) <= known
        assert film_settings([preset.name]) != FilmSettings()
        assert preset.sentence.endswith(".")


def test_presets_combine_and_the_later_one_wins() -> None:
    both = film_settings(["glossy", "rolling-shutter", "translucent"])
    assert (both.readout_share, both.translucency) == (0.8, 0.6)
    assert both.roughness == film_settings(["translucent"]).roughness
    assert preset_values([]) == {}
    assert film_settings() == FilmSettings()


def test_explicit_options_win_over_presets(plan: Path) -> None:
    settings = film_settings(["phone", "rounded"], fps=500.0, exposure_s=1e-3, corner_radius_m=0.001, response="linear")
    job = film_job(read_plan(plan), None, settings, "film")
    assert (job.fps, job.exposure_s, job.die.corner_radius_m) == (500.0, 1e-3, 0.001)
    assert job.readout_s == pytest.approx(0.75 / 500.0)  # a share of the frame interval, which the option changed
    assert "response" not in scene_text(job, job.clip_name)
    assert job.clip_name == "clip.mp4"
    # Another codec does not inherit the rate factor of the preset's.
    assert film_settings(["low-bitrate"], codec="ffv1").stored_as.crf is None


def test_an_option_on_the_command_line_wins_over_a_preset_and_none_leaves_the_preset(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[FilmSettings] = []

    def shoot(*_: object, settings: FilmSettings, **__: object) -> None:
        seen.append(settings)
        raise InputError("seen enough")

    monkeypatch.setattr("diethrow.commands.model.filmed_throw.film", shoot)
    words = ("film", plan, "--out", tmp_path / "film", "--preset", "phone", "--preset", "glossy")
    assert "seen enough" in invoke(*words, "--fps", 480, "--codec", "hevc", "--readout", 0.001)[2]
    (settings,) = seen
    assert (settings.fps, settings.codec, settings.readout_s) == (480.0, "hevc", 0.001)
    assert (settings.response, settings.roughness, settings.exposure_share) == ("srgb", 0.05, 0.25)


def test_all_presets_are_listed_by_the_command_line() -> None:
    status, text, _ = invoke("film", "--list-presets")
    assert status == 0
    words = " ".join(text.split())
    for name, sentence in preset_rows():
        assert name in words
        assert sentence.split()[0] in words


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("--preset", "telephone"), "preset 'telephone': wanted one of phone, rolling-shutter"),
        (("--crf", 20), "crf = 20: ffv1 stores frames without loss"),
        (("--preset", "h264", "--bits", 12), "bit_depth = 12: wanted one of 8, 10 for h264"),
        (("--readout", 1), "readout_s = 1.0: wanted at most the 0.001 s between two frames"),
        (("--aperture", -1), "aperture_m = -1.0"),
        (("--corner-radius", 0.01), "corner_radius_m = 0.01: wanted at most 0.0076"),
        (("--roughness", 0), "roughness = 0.0: wanted a finite number above 0"),
    ],
)
def test_impossible_settings_are_refused_by_name(
    plan: Path, tmp_path: Path, words: tuple[object, ...], wanted: str
) -> None:
    status, _, error = invoke("film", plan, "--out", tmp_path / "film", *words)
    assert status in (1, 2)
    assert wanted in error
    assert not (tmp_path / "film").exists()
