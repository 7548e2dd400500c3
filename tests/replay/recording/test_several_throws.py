"""Joined recordings keep their data, on one clock and in a colour of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import replay_records as made
from rrd_files import entities, rows, verify
from throws import later

from diethrow.model.throw.motion import Throw
from diethrow.replay.elements.colours import BLACK, MEASURED, SIMULATED, THROW_COLOURS, WHITE, Colour, mixed
from diethrow.replay.recording.several_throws import Source, join_recordings, recoloured
from diethrow.replay.recording.throw_recording import write_recording, write_throw_recording

LATER_FRAMES = 5
EXACT_NS = round(1e9 * made.IMPACT_S)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> list[Source]:
    """A throw, and the same filmed five frames later."""
    folder, shift_s = tmp_path_factory.mktemp("two"), LATER_FRAMES / made.FPS
    write_recording(folder / "first.rrd", made.record())
    track = made.track()
    moved = replace(track, frame=track.frame + LATER_FRAMES, time_s=track.time_s + shift_s)
    model = replace(made.track(2e-4, gaps=False), frame=moved.frame, time_s=moved.time_s)
    throw = later(made.throw(), shift_s)
    film = replace(
        made.coded_clip(), times_s=made.coded_clip().times_s + shift_s, first_frame=made.FIRST_FRAME + LATER_FRAMES
    )
    fit = made.fit(throw=throw)
    record = made.record(title="late", track=moved, measured=throw, simulated=model, clip=film, fit=fit, estimates=())
    write_recording(folder / "second.rrd", record)
    return [Source(folder / "first.rrd", "first"), Source(folder / "second.rrd", "the 2nd")]


@pytest.fixture(scope="module")
def joined(two: list[Source]) -> Path:
    path = two[0].path.with_name("joined.rrd")
    join_recordings(path, two)
    return path


@pytest.fixture(scope="module")
def models(two: list[Source]) -> Path:
    path = two[0].path.with_name("models.rrd")
    join_recordings(path, [two[0], replace(two[0], name="again")], same_throw=True)
    return path


def test_the_viewer_accepts_both_kinds(joined: Path, models: Path) -> None:
    assert verify(joined).returncode == 0
    assert verify(models).returncode == 0


def test_the_first_bounces_coincide_to_the_nanosecond(joined: Path) -> None:
    """The first throw is delayed, because the second one bounces five frames later."""
    times = [rows(joined, f"/events/{name}/measured", "TextLog:text")[0][0] for name in ("first", "the_2nd")]
    assert times[0] == times[1]
    assert times[0] == pytest.approx(EXACT_NS + 1e9 * LATER_FRAMES / made.FPS, abs=1.0)
    frames = [rows(joined, f"/events/{name}/measured", "TextLog:text", "frame")[0][0] for name in ("first", "the_2nd")]
    assert frames[0] == frames[1]


def test_aligned_at_frame_0_every_clock_is_unchanged(two: list[Source], tmp_path: Path) -> None:
    join_recordings(tmp_path / "by_frame.rrd", two, at_bounce=False)
    for source, name in zip(two, ("first", "the_2nd"), strict=True):
        for timeline in ("t", "frame"):
            before = rows(source.path, "/world/measured/die", "Transform3D:translation", timeline)
            after = rows(tmp_path / "by_frame.rrd", f"/world/{name}/measured/die", "Transform3D:translation", timeline)
            assert after == before


def test_videos_and_poses_keep_every_digit(two: list[Source], joined: Path) -> None:
    shift = LATER_FRAMES
    for source, name, moved in zip(two, ("first", "the_2nd"), (shift, 0), strict=True):
        (film,) = rows(source.path, "/world/camera/image", "AssetVideo:blob")
        assert rows(joined, f"/world/{name}/camera/image", "AssetVideo:blob") == [film]
        for entity, component in (
            ("measured/die", "Transform3D:quaternion"),
            ("camera/image", "VideoFrameReference:timestamp"),
        ):
            before = rows(source.path, f"/world/{entity}", component, "frame")
            after = rows(joined, f"/world/{name}/{entity}", component, "frame")
            assert after == [(frame + moved, value) for frame, value in before]


def test_each_throw_has_its_colour_and_its_model_a_paler_one(joined: Path) -> None:
    for name, colour in zip(("first", "the_2nd"), THROW_COLOURS, strict=False):
        for motion, wanted in (("measured", colour), ("simulated", mixed(colour, WHITE, 0.45))):
            (found,) = rows(joined, f"/plots/spin/{name}/{motion}", "SeriesLines:colors")
            assert found[1] == [int.from_bytes(bytes([*wanted, 255]), "big")]
    ((_, names),) = rows(joined, "/plots/spin/the_2nd/simulated", "SeriesLines:names")
    assert names == ["the 2nd, model"]


def test_the_height_of_the_lowest_corner_is_the_least_of_all(two: list[Source], joined: Path) -> None:
    all_corners = [min(value) for _, value in rows(two[1].path, "/plots/height/measured", "Scalars:scalars")]
    lowest = [value[0] for _, value in rows(joined, "/plots/lowest/the_2nd/measured", "Scalars:scalars")]
    assert lowest == all_corners


def test_models_of_one_throw_share_its_video_and_its_measured_die(models: Path) -> None:
    there = entities(models)
    assert {"/world/camera/image", "/world/measured/die", "/world/first/die", "/world/again/die"} <= there
    assert "/world/camera/image/silhouette/again" in there
    assert "/plots/residual/again/rms_sigmas" in there
    assert not any("simulated" in entity for entity in there)
    ((_, measured),) = rows(models, "/plots/spin/measured", "SeriesLines:colors")
    assert measured == [int.from_bytes(bytes([*MEASURED, 255]), "big")]
    colours = {tuple(rows(models, f"/plots/spin/{name}", "SeriesLines:colors")[0][1]) for name in ("first", "again")}
    assert len(colours) == 2
    rest = {
        tuple(rows(models, f"/plots/residual/{n}/rms_sigmas", "SeriesLines:colors")[0][1]) for n in ("first", "again")
    }
    assert rest == colours


@pytest.mark.parametrize("share", [0.0, 0.2, 0.35, 0.6])
@pytest.mark.parametrize("extreme", [WHITE, BLACK])
def test_a_tint_becomes_the_same_tint_of_the_new_colour(share: float, extreme: Colour) -> None:
    """To within the rounding of both."""
    new = THROW_COLOURS[2]
    found = recoloured(mixed(MEASURED, extreme, share), MEASURED, new)
    assert found is not None
    assert np.abs(np.subtract(found, mixed(new, extreme, share))).max() <= 3


def test_a_colour_that_is_no_tint_is_unchanged() -> None:
    for other in (SIMULATED, (128, 128, 128), WHITE, BLACK):
        assert recoloured(other, MEASURED, THROW_COLOURS[2]) is None


def test_recordings_of_different_rates_count_no_frames_together(two: list[Source], tmp_path: Path) -> None:
    slow = tmp_path / "slow.rrd"
    write_throw_recording(slow, made.die(), made.throw(), 1000.0, "slow")
    join_recordings(tmp_path / "mixed.rrd", [two[0], Source(slow, "slow")])
    assert rows(tmp_path / "mixed.rrd", "/world/first/measured/die", "Transform3D:translation", "frame") == []
    times = [
        rows(tmp_path / "mixed.rrd", f"/events/{n}", "TextLog:text")[0][0] for n in ("first/measured", "slow/simulated")
    ]
    assert times[0] == times[1] == EXACT_NS


def test_recordings_that_cannot_be_joined_are_errors(two: list[Source], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="same name"):
        join_recordings(tmp_path / "x.rrd", [two[0], two[0]])
    with pytest.raises(FileNotFoundError, match="no such recording"):
        join_recordings(tmp_path / "x.rrd", [two[0], Source(tmp_path / "none.rrd", "none")])
    (tmp_path / "text.rrd").write_text("no recording")
    with pytest.raises(ValueError, match=r"not a Rerun recording|no moving die"):
        join_recordings(tmp_path / "x.rrd", [two[0], Source(tmp_path / "text.rrd", "text")])
    still = Throw((made.throw().flights[0],), ())
    write_throw_recording(tmp_path / "still.rrd", made.die(), still, 1000.0, "still")
    with pytest.raises(ValueError, match="--align frame"):
        join_recordings(tmp_path / "x.rrd", [two[0], Source(tmp_path / "still.rrd", "still")])
    assert not (tmp_path / "x.rrd").exists()
