"""A recording contains every frame, pose and bounce at its nanosecond, and nothing without a pose."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
import replay_records as made
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from rrd_files import contents, entities, rows, verify

from diethrow.model.rotations import matrix_from_quat
from diethrow.replay.elements import video
from diethrow.replay.elements.colours import MEASURED, SIMULATED
from diethrow.replay.elements.record import residuals
from diethrow.replay.recording import scenery, throw_recording
from diethrow.replay.recording.several_throws import properties_of
from diethrow.replay.recording.throw_recording import write_recording, write_throw_recording
from diethrow.tracking.track import ABSENT


def nanoseconds(times_s: Any) -> list[int]:
    return [round(float(t) * 1e9) for t in np.atleast_1d(times_s)]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "replay.rrd"
    write_recording(path, made.record())
    return path


def test_the_viewer_accepts_the_file(written: Path) -> None:
    done = verify(written)
    assert done.returncode == 0, done.stderr


def test_a_truncated_file_is_not_accepted(written: Path, tmp_path: Path) -> None:
    """Otherwise the test above would prove nothing."""
    torso = tmp_path / "torso.rrd"
    torso.write_bytes(written.read_bytes()[:-2000])
    assert verify(torso).returncode != 0


def test_the_file_contains_its_own_views(written: Path) -> None:
    assert len(RrdReader(written).recordings()) == 1
    assert len(RrdReader(written).blueprints()) == 1


@pytest.mark.parametrize(("timeline", "unit"), [("t", 1e9 / made.FPS), ("frame", 1.0)])
def test_every_known_pose_has_its_own_time(written: Path, timeline: str, unit: float) -> None:
    track = made.track()
    back = rows(written, "/world/measured/die", "Transform3D:translation", timeline)
    assert [time for time, _ in back] == [round(k * unit) for k in track.frame[track.tracked].tolist()]
    positions = np.array([value[0] for _, value in back])
    # The file holds single precision: 0.05 m to one part in 2**24.
    np.testing.assert_allclose(positions, track.position_m[track.tracked], atol=4e-9)


def test_orientations_are_stored_with_the_scalar_last(written: Path) -> None:
    track = made.track()
    back = np.array([value[0] for _, value in rows(written, "/world/measured/die", "Transform3D:quaternion")])
    np.testing.assert_allclose(np.roll(back, 1, axis=1), track.quaternion[track.tracked], atol=1e-7)


def test_a_frame_without_a_pose_shows_no_die(written: Path) -> None:
    """The mesh begins with each run of poses, and everything is cleared on each frame without one."""
    track = made.track()
    for entity in ("/world/measured/die", "/world/camera/image/silhouette/measured", "/plots/height/measured"):
        cleared = rows(written, entity, "Clear:is_recursive", "frame")
        assert [frame for frame, _ in cleared] == track.frame[~track.tracked].tolist()
    meshes = rows(written, "/world/measured/die", "Mesh3D:vertex_positions", "frame")
    assert [frame for frame, _ in meshes] == [made.FIRST_FRAME + 3, made.FIRST_FRAME + 34]


def test_a_bounce_has_its_own_instant_and_the_first_frame_after_it(written: Path) -> None:
    for name in ("measured", "simulated"):
        ((time, text),) = rows(written, f"/events/{name}", "TextLog:text", "t")
        assert time == nanoseconds(made.IMPACT_S)[0]
        assert "vertex 0" in text[0]
        ((frame, _),) = rows(written, f"/events/{name}", "TextLog:text", "frame")
        assert frame == int(np.ceil(made.IMPACT_S * made.FPS))


def test_a_bounce_is_a_point_with_its_impulse_and_a_line_in_the_plot(written: Path) -> None:
    """The impulse of 5 mN s is the largest, so its arrow is 3 radii long. The line runs from the table up, then ends (NaN)."""
    instant = nanoseconds(made.IMPACT_S)[0]
    for name in ("measured", "simulated"):
        assert [time for time, _ in rows(written, f"/world/{name}/impacts", "Points3D:positions")] == [instant]
        ((time, arrows),) = rows(written, f"/world/{name}/impulses", "Arrows3D:vectors")
        assert time == instant
        np.testing.assert_allclose(arrows, [[0.0, 0.0, 3.0 * made.die().solid.circumradius]], rtol=1e-6)
        ((_, labels),) = rows(written, f"/world/{name}/impulses/strength", "Points3D:labels")
        assert labels == ["1: 5 mN s"]
        line = rows(written, f"/plots/height/bounces/{name}", "Scalars:scalars")
        assert [time for time, _ in line] == [instant] * 3
        assert line[0][1] == [0.0]
        assert np.isnan(line[2][1][0])


def test_an_impulse_that_is_not_known_leaves_the_number_of_the_bounce(tmp_path: Path) -> None:
    throw = made.throw()
    silent = replace(throw, impacts=(replace(throw.impacts[0], impulse_N_s=np.full(3, np.nan)),))
    path = tmp_path / "silent.rrd"
    write_recording(path, made.record(clip=None, measured=silent, fit=None, simulated=None, estimates=()))
    assert rows(path, "/world/measured/impulses", "Arrows3D:vectors") == []
    ((_, labels),) = rows(path, "/world/measured/impulses/strength", "Points3D:labels")
    assert labels == ["1"]


def test_heights_are_those_of_the_corners(written: Path) -> None:
    track, solid = made.track(), made.die().solid
    known = track.tracked
    heights = rows(written, "/plots/height/measured", "Scalars:scalars")
    assert len(heights) == known.sum()
    lowest = min(min(value) for _, value in heights)
    # The corner comes down to the table between two frames; 0.6 m/s over one frame is 0.4 mm.
    assert 0.0 <= lowest < 0.4
    means = [np.mean(value) for _, value in heights]
    np.testing.assert_allclose(means, 1e3 * track.position_m[known, 2], atol=1e-9)
    assert all(len(value) == len(solid.vertices) for _, value in heights)


def test_the_drawn_corners_are_where_the_camera_projects_them(written: Path) -> None:
    """A visible corner lies half a pixel from where the camera model puts it: the viewer counts from the corner of
    the first pixel, the camera model from its centre."""
    track, solid, camera = made.track(), made.die().solid, made.camera()
    frame, first = rows(written, "/world/camera/image/corners/measured", "Points2D:positions", "frame")[0]
    row = frame - made.FIRST_FRAME
    corners = solid.vertices @ matrix_from_quat(track.quaternion[row]).T + track.position_m[row]
    projected = camera.project(corners) + 0.5
    distances = np.linalg.norm(np.asarray(first)[:, None] - projected[None], axis=2).min(1)
    assert len(first) in (4, 6, 7)
    # Single precision at 100 px.
    assert distances.max() < 1e-4


def test_residuals_are_measured_minus_simulated(written: Path) -> None:
    known = made.track().tracked
    back = [value[0] for _, value in rows(written, "/plots/residual/position_mm/x", "Measurements:values")]
    # The simulated track was set off by +0.01 mm.
    np.testing.assert_allclose(back, np.full(known.sum(), -0.01), atol=1e-9)


def test_residuals_stand_beside_their_standard_errors(written: Path) -> None:
    """Sigmas of 0.01 mm and 1 mrad; the simulated track was set off by one of the former."""
    variances = [value[0] for _, value in rows(written, "/plots/residual/position_mm/x", "Measurements:variances")]
    np.testing.assert_allclose(variances, 1e-4, rtol=1e-9)
    variances = [value[0] for _, value in rows(written, "/plots/residual/turn_deg/z", "Measurements:variances")]
    np.testing.assert_allclose(variances, np.rad2deg(1e-3) ** 2, rtol=1e-9)
    sigmas = [value[0] for _, value in rows(written, "/plots/residual/position_sigmas/x", "Scalars:scalars")]
    np.testing.assert_allclose(sigmas, -1.0, atol=1e-6)
    band = rows(written, "/plots/residual/position_sigmas/band_2", "Measurements:variances")
    assert [value for _, value in band] == [[4.0], [4.0]]


def test_estimates_of_chi_and_of_the_faces_hold_from_the_bounce_to_the_end(written: Path) -> None:
    begin, end = nanoseconds(made.IMPACT_S)[0], nanoseconds((made.FIRST_FRAME + made.FRAMES - 1) / made.FPS)[0]
    chi = rows(written, "/plots/chi/estimate", "Measurements:values")
    assert chi == [(begin, [0.583]), (end, [0.583])]
    variances = [value[0] for _, value in rows(written, "/plots/chi/estimate", "Measurements:variances")]
    np.testing.assert_allclose(np.sqrt(variances), 0.006 / (2 * 1.96), rtol=1e-9)
    assert rows(written, "/plots/odds/face_3", "Scalars:scalars") == [(begin, [0.75]), (end, [0.75])]
    assert "/plots/odds/face_1" not in entities(written)
    ((time, said),) = rows(written, "/events/told", "TextLog:text")
    assert time == begin
    assert said == ["fit after 1 bounce: χ = 0.5830 (0.5800 to 0.5860), lands on face 3 with odds of 0.75"]


def test_the_recording_has_the_properties_that_a_table_shows(written: Path) -> None:
    said = properties_of(written)
    assert (said["chi"], said["chi_low"], said["chi_high"]) == (0.5831, 0.5802, 0.5859)
    assert (said["bounces"], said["bounces_fitted"], said["verdict"]) == (1, 1, "1 of 1 bounce explained")


def test_one_throw_keeps_its_identity_and_another_model_has_its_own(tmp_path: Path) -> None:
    """The viewer merges recordings with the same id."""
    names = []
    for k, shift_m in enumerate((1e-5, 1e-5, 2e-5)):
        path = tmp_path / f"{k}.rrd"
        write_recording(path, made.record(clip=None, simulated=made.track(shift_m, gaps=False)))
        names.append(RrdReader(path).recordings()[0].recording_id)
    assert names[0] == names[1] != names[2]
    assert all(name.startswith("a throw-") for name in names)


def test_one_record_gives_recordings_of_the_same_contents(written: Path, tmp_path: Path) -> None:
    again, other = tmp_path / "again.rrd", tmp_path / "other.rrd"
    write_recording(again, made.record())
    write_recording(other, made.record(simulated=made.track(2e-5, gaps=False)))
    assert len(contents(written)) > 100
    assert contents(again) == contents(written)
    assert contents(other) != contents(written)


def test_measured_and_simulated_keep_their_colours_everywhere(written: Path) -> None:
    for name, colour in (("measured", MEASURED), ("simulated", SIMULATED)):
        packed = int.from_bytes(bytes([*colour, 255]), "big")
        found = [
            *rows(written, f"/world/camera/image/silhouette/{name}", "LineStrips2D:colors"),
            *rows(written, f"/world/{name}/impacts", "Points3D:colors"),
            *rows(written, f"/plots/spin/{name}", "SeriesLines:colors"),
        ]
        assert [value for _, value in found] == [[packed]] * 3


def test_every_frame_of_the_video_shows_its_own_image(written: Path) -> None:
    """Decoded again, the picture that each frame refers to carries that frame's number."""
    ((_, blob),) = rows(written, "/world/camera/image", "AssetVideo:blob")
    references = rows(written, "/world/camera/image", "VideoFrameReference:timestamp", "frame")
    assert [frame for frame, _ in references] == list(range(made.FIRST_FRAME, made.FIRST_FRAME + made.FRAMES))
    with av.open(io.BytesIO(bytes(blob[0]))) as film:
        shown = {round(picture.time * 1e9): picture.to_ndarray(format="gray") for picture in film.decode(video=0)}
    for k, (_, stamp) in enumerate(references):
        nearest = min(shown, key=lambda time: abs(time - stamp[0]))
        assert abs(nearest - stamp[0]) <= 1
        assert made.code_of(shown[nearest]) == k


def test_the_video_of_a_long_clip_shows_one_frame_in_so_many_at_its_own_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "MOST_SHOWN_FRAMES", 25)
    path = tmp_path / "long.rrd"
    write_recording(path, made.record(clip=made.coded_clip()))
    ((_, blob),) = rows(path, "/world/camera/image", "AssetVideo:blob")
    references = rows(path, "/world/camera/image", "VideoFrameReference:timestamp", "frame")
    shown = np.arange(0, made.FRAMES, 3)
    assert [frame for frame, _ in references] == (made.FIRST_FRAME + shown).tolist()
    with av.open(io.BytesIO(bytes(blob[0]))) as film:
        codes = [made.code_of(picture.to_ndarray(format="gray")) for picture in film.decode(video=0)]
    assert codes == shown.tolist()
    ((_, text),) = rows(path, "/report/estimate", "TextDocument:text")
    assert "one frame in 3" in text[0]


def test_a_video_encoded_ahead_is_that_of_the_recording(tmp_path: Path) -> None:
    clip = made.coded_clip()
    with video.VideoEncoding(lambda: clip) as encoding:
        assert encoding.result() == video.encode_av1(clip, video.display_window(clip))


def test_the_end_of_the_block_stops_an_encoding() -> None:
    """However long the clip is, and whether or not anybody waits for the video."""
    clip = made.coded_clip(4)
    read = []

    class Endless(made.ArrayClip):
        def frames(self, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
            while True:
                read.append(1)
                yield clip.array[0]

    with video.VideoEncoding(lambda: Endless(clip.array, clip.times_s)) as encoding:
        while len(read) < 3:
            time.sleep(0.01)
    count = len(read)
    time.sleep(0.1)
    assert len(read) == count
    with pytest.raises(CancelledError):
        encoding.result()


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="this system has no such priorities")
def test_encoding_a_video_leaves_no_thread_at_real_time_priority() -> None:
    """Started by root the encoder takes real-time priority 99, and a viewer started afterwards would stop the machine."""
    clip = made.coded_clip()
    video.encode_av1(clip, video.display_window(clip))
    for thread in os.listdir("/proc/self/task"):
        assert os.sched_getscheduler(int(thread)) not in (os.SCHED_FIFO, os.SCHED_RR)


def test_without_av1_every_frame_is_a_jpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenery, "can_encode_av1", lambda: False)
    path = tmp_path / "jpeg.rrd"
    write_recording(path, made.record(clip=made.coded_clip(5)))
    pictures = rows(path, "/world/camera/image", "EncodedImage:blob", "frame")
    for k, (frame, blob) in enumerate(pictures):
        assert frame == made.FIRST_FRAME + k
        data = np.frombuffer(bytes(blob[0]), np.uint8)
        assert made.code_of(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)) == k
    assert len(pictures) == 5
    ((_, text),) = rows(path, "/report/estimate", "TextDocument:text")
    assert "JPEG" in text[0]


def test_deep_footage_is_mapped_to_8_bits_by_one_stated_window(tmp_path: Path) -> None:
    clip = made.coded_clip(6, bit_depth=12)
    window = video.display_window(clip)
    np.testing.assert_array_equal(window.apply(np.array([[0, 4095]], np.uint16)), [[0, 255]])
    path = tmp_path / "deep.rrd"
    write_recording(path, made.record(clip=clip))
    ((_, text),) = rows(path, "/report/estimate", "TextDocument:text")
    assert "grey levels 0 to 4095 of 12 bits" in text[0]


def test_eight_bits_are_shown_as_they_are() -> None:
    clip = made.coded_clip(3)
    np.testing.assert_array_equal(video.display_window(clip).apply(clip.frame(2)), clip.frame(2))


def test_parts_that_the_record_lacks_are_absent(tmp_path: Path) -> None:
    path = tmp_path / "bare.rrd"
    write_recording(path, made.record(clip=None, camera=None, fit=None, simulated=None, estimates=()))
    assert verify(path).returncode == 0
    there = entities(path)
    for prefix in ("/world/camera", "/world/simulated", "/plots/residual", "/plots/chi/estimate", "/plots/odds"):
        assert not any(entity.startswith(prefix) for entity in there)
    ((_, text),) = rows(path, "/report/estimate", "TextDocument:text")
    assert "No model was fitted" in text[0]
    assert "no video" in text[0]


def test_a_track_without_any_pose_still_makes_a_recording(tmp_path: Path) -> None:
    track = made.track()
    nothing = np.full_like(track.position_m, np.nan)
    empty = made.Track(
        track.frame,
        track.time_s,
        nothing,
        np.full_like(track.quaternion, np.nan),
        np.full_like(track.covariance, np.nan),
        np.full(len(track), ABSENT),
    )
    path = tmp_path / "empty.rrd"
    write_recording(path, made.record(track=empty, fit=None, simulated=None))
    assert verify(path).returncode == 0
    assert rows(path, "/world/measured/die", "Transform3D:translation") == []


def test_a_modelled_throw_alone_stands_on_the_frames_of_its_camera(tmp_path: Path) -> None:
    path = tmp_path / "throw.rrd"
    write_throw_recording(path, made.die(), made.throw(), 1000.0, "alone")
    assert verify(path).returncode == 0
    frames = [frame for frame, _ in rows(path, "/world/simulated/die", "Transform3D:translation", "frame")]
    times = [time for time, _ in rows(path, "/world/simulated/die", "Transform3D:translation", "t")]
    assert frames == list(range(frames[0], frames[0] + len(frames)))
    assert times == [1_000_000 * frame for frame in frames]
    assert not any(entity.startswith("/world/measured") for entity in entities(path))


def test_a_rate_of_zero_or_without_a_frame_in_the_throw_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="fps = 0"):
        write_throw_recording(tmp_path / "x.rrd", made.die(), made.throw(), 0.0, "x")
    with pytest.raises(ValueError, match="raise fps"):
        write_throw_recording(tmp_path / "x.rrd", made.die(), made.throw(), 1.0, "x")


def test_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is not a folder"):
        write_recording(tmp_path / "nowhere" / "x.rrd", made.record())


def test_a_failure_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("stopped half-way")

    monkeypatch.setattr(throw_recording, "send_residuals", fail)
    path = tmp_path / "x.rrd"
    with pytest.raises(RuntimeError, match="half-way"):
        write_recording(path, made.record())
    assert not path.exists()


def test_residuals_in_sigmas_are_those_of_the_covariance() -> None:
    """Set off by one sigma along x alone: the root mean square of six is 1/√6. A turn is read as its angle."""
    track, moved = made.track(), made.track(1e-5)
    rest = residuals(track, moved)
    np.testing.assert_allclose(rest.sigmas, 1.0 / np.sqrt(6.0), rtol=1e-6)
    turned = made.Track(
        track.frame,
        track.time_s,
        track.position_m,
        np.where(
            track.tracked[:, None],
            made.turned(np.nan_to_num(track.quaternion, nan=0.5), np.array([0, 0, 0.01])),
            np.nan,
        ),
        track.covariance,
        track.status,
    )
    np.testing.assert_allclose(residuals(turned, track).rotation_deg, np.rad2deg(0.01), rtol=1e-6)
    assert residuals(track, moved).frame.tolist() == track.frame[track.tracked].tolist()


def test_a_singular_covariance_gives_no_sigmas() -> None:
    track = made.track()
    flat = made.Track(
        track.frame, track.time_s, track.position_m, track.quaternion, np.zeros_like(track.covariance), track.status
    )
    assert np.isnan(residuals(flat, made.track(1e-5)).sigmas).all()
