"""The player: its data are the poses of the tracks, and in a browser it draws them where the camera saw the die."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import replay_records as made
from browser import Page, opened
from numpy.typing import NDArray

from diethrow.model.throw.motion import Throw
from diethrow.replay.elements.record import motion_of, motions_of, track_of
from diethrow.replay.pages.report import report_page, write_report
from diethrow.replay.player import packed_throw, player_alone, player_html, player_policy, player_script
from diethrow.tracking.track import ABSENT, TRACKED, Track

CORNER_TOLERANCE_PX = 0.5 / packed_throw.CORNER_UNITS + 1e-9
"""Corners are stored in eighths of a pixel."""
SETTLED_S = 20.0
GO_TO = """(() => {{
  const slider = document.querySelector('[data-part="time"]');
  slider.value = {};
  slider.dispatchEvent(new Event("input"));
}})()"""
USABLE = {"button", "slider", "combobox", "checkbox", "link", "image"}
COLOURS_OF_CANVAS = """(() => {
  const canvas = document.querySelector(".player canvas");
  const pixels = new Uint32Array(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  return new Set(pixels).size;
})()"""


def data_of(html: str) -> dict[str, Any]:
    """What the script reads."""
    found = re.search('<script type="application/json">(.*?)</script>', html)
    assert found is not None
    return dict(json.loads(found[1]))


def numbers(text: str, kind: str) -> NDArray[Any]:
    return np.frombuffer(base64.b64decode(text), kind)


def test_the_data_are_the_poses_and_what_the_camera_saw_of_them() -> None:
    record = made.record()
    data = data_of(
        player_html(record.die.solid, motions_of(record), record.measured.bounces, record.camera, "<svg></svg>")
    )
    frame = numbers(data["frame"], "<i4")
    assert frame.tolist() == record.track.frame.tolist()
    np.testing.assert_allclose(numbers(data["time_ms"], "<f4"), 1e3 * record.track.time_s, rtol=1e-7)
    measured = numbers(data["motions"][0]["poses"], "<f4").reshape(-1, 7)
    np.testing.assert_allclose(measured[:, :3], record.track.position_m, rtol=1e-7)
    np.testing.assert_allclose(measured[:, 3:], record.track.quaternion, rtol=1e-6)
    corners = numbers(data["motions"][1]["corners"], "<i2").reshape(len(frame), -1, 2) / packed_throw.CORNER_UNITS
    assert record.camera is not None
    seen = record.camera.project(motions_of(record)[1].corners_m(record.die.solid))
    assert np.abs(corners - seen).max() <= CORNER_TOLERANCE_PX
    assert [impact["time_ms"] for impact in data["impacts"]] == [pytest.approx(1e3 * made.IMPACT_S, abs=1e-4)]


def test_frames_without_a_pose_have_none() -> None:
    record = made.record(simulated=None)
    data = data_of(player_html(record.die.solid, motions_of(record), (), record.camera, "<svg></svg>"))
    frame = numbers(data["frame"], "<i4")
    tracked = set(record.track.frame[record.track.tracked].tolist())
    assert set(frame.tolist()) == tracked


def test_a_bounce_whose_place_is_not_known_keeps_its_number() -> None:
    known = made.throw().impacts[0]
    unknown = replace(known, time_s=known.time_s - 0.005, point_m=np.full(2, np.nan))
    motions = motions_of(made.record())
    impacts = data_of(player_html(made.die().solid, motions, (unknown, known)))["impacts"]
    assert [impact["place_m"] for impact in impacts] == [None, [0.0, 0.0]]


def test_a_corner_that_the_camera_does_not_see_is_marked() -> None:
    """A die behind the camera has no place in its picture, and one far beside it none that sixteen bits hold."""
    camera, solid = made.camera(), made.die().solid
    behind = camera.centre_m + (camera.centre_m - np.array([0.0, 0.0, 0.02]))
    beside = np.array([200.0, 0.0, 0.02])
    track = Track(
        np.arange(2),
        np.arange(2) / made.FPS,
        np.array([behind, beside]),
        np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        np.full((2, 6, 6), np.nan),
        np.full(2, TRACKED),
    )
    data = data_of(player_html(solid, [motion_of("measured", track, None)], (), camera, "<svg></svg>"))
    assert (numbers(data["motions"][0]["corners"], "<i2") == packed_throw.UNKNOWN).all()


def test_a_long_clip_has_every_nth_frame_and_the_caption_says_so() -> None:
    count = 5 * packed_throw.MOST_FRAMES
    flight = made.throw().flights[0]
    times = np.linspace(flight.start.time_s, flight.end_s, count)
    positions, quaternions = flight.poses(times)
    unknown = np.full((count, 6, 6), np.nan)
    track = Track(np.arange(count), times, positions, quaternions, unknown, np.full(count, TRACKED))
    html = player_html(made.die().solid, [motion_of("measured", track, None)], ())
    assert len(numbers(data_of(html)["frame"], "<i4")) == packed_throw.MOST_FRAMES
    assert "Every 5th frame is shown." in html


def test_without_a_pose_there_is_only_the_picture() -> None:
    track = made.track()
    nothing = Track(
        track.frame, track.time_s, track.position_m, track.quaternion, track.covariance, np.full(60, ABSENT)
    )
    assert player_html(made.die().solid, [motion_of("measured", nothing, None)], (), None, "a picture") == "a picture"


def test_the_policy_admits_the_script_of_the_player_alone() -> None:
    script = player_script().removeprefix("<script>").removesuffix("</script>")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert player_policy() == f"script-src 'sha256-{digest}'"
    assert f"script-src 'sha256-{digest}'\"" in report_page(made.record())
    assert len(script.encode()) < 60_000


# --- in a browser ---


def outline_px(page: Page, motion: str) -> NDArray[np.float64]:
    """The corners (n, 2) of the outline on the picture, in the camera's pixels."""
    d = page.evaluate(f"document.querySelector('svg path[data-motion=\"{motion}\"]').getAttribute('d')")
    return np.array([[float(value) for value in place.split()] for place in re.split("[MLz]+", d) if place])


def test_the_outline_on_the_picture_is_what_the_camera_sees(tmp_path: Path) -> None:
    record, file = made.record(), tmp_path / "report.html"
    write_report(file, record)
    assert record.camera is not None
    solid, motions = record.die.solid, motions_of(record)
    with opened(file.as_uri(), tmp_path / "browser") as page:
        for row in (10, 45):
            page.evaluate(GO_TO.format(row))
            frame = int(page.evaluate("document.querySelector('.player').dataset.frame"))
            assert frame == record.track.frame[row]
            for motion in motions:
                k = int(np.searchsorted(motion.frame, frame))
                corners = motion.corners_m(solid)[k]
                towards = np.array([record.camera.centre_m - corners[face[0]] for face in solid.faces])
                turned = solid.normals @ motion_rotation(motion.quaternion[k]).T
                facing = [face for face, n, v in zip(solid.faces, turned, towards, strict=True) if n @ v > 0.0]
                wanted = record.camera.project(corners[[vertex for face in facing for vertex in face]])
                found = outline_px(page, motion.name)
                assert found.shape == wanted.shape
                assert np.abs(found - wanted).max() <= CORNER_TOLERANCE_PX
        # A frame without a measured pose has only the model's outline, and says so.
        page.evaluate(GO_TO.format(31))
        assert len(outline_px(page, "measured")) == 0
        assert len(outline_px(page, "simulated")) > 0
        assert "no measured pose" in page.evaluate("document.querySelector('[data-part=\"now\"]').textContent")
        assert page.errors == []


def motion_rotation(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    from diethrow.model.rotations import matrix_from_quat

    return matrix_from_quat(quaternion)


def test_the_throw_plays_to_its_end_and_follows_keys_and_boxes(tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    write_report(file, made.record())
    with opened(file.as_uri(), tmp_path / "browser") as page:
        text = "document.querySelector('[data-part=\"play\"]').textContent"
        assert page.evaluate(COLOURS_OF_CANVAS) > 20
        page.evaluate("document.querySelector('[data-part=\"speed\"]').value = 1")
        page.evaluate("document.querySelector('[data-part=\"play\"]').click()")
        page.wait_for(f"{text} === '▶ Play'", SETTLED_S)
        assert page.evaluate("document.querySelector('.player').dataset.frame") == "66"
        page.evaluate("document.querySelector('[data-part=\"time\"]').focus()")
        page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", windowsVirtualKeyCode=37)
        page.wait_for("document.querySelector('.player').dataset.frame === '65'", SETTLED_S)
        before = page.evaluate("document.querySelector('.player canvas').toDataURL()")
        page.evaluate("document.querySelector('.player canvas').focus()")
        page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", windowsVirtualKeyCode=37)
        turned = page.evaluate("document.querySelector('.player canvas').toDataURL()")
        assert turned != before
        assert page.evaluate("document.querySelector('.player').dataset.frame") == "65"
        for name in ("measured", "simulated"):
            page.evaluate(f"document.querySelector('input[data-motion={name}]').click()")
            assert len(outline_px(page, name)) == 0
        assert page.evaluate("document.querySelector('.player canvas').toDataURL()") != turned
        assert page.errors == []


def test_whatever_can_be_used_has_a_name_for_those_who_do_not_see_it(tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    write_report(file, made.record())
    with opened(file.as_uri(), tmp_path / "browser") as page:
        page.call("Accessibility.enable")
        nodes = page.call("Accessibility.getFullAXTree")["nodes"]
        named = {
            (node["role"]["value"], node.get("name", {}).get("value", ""))
            for node in nodes
            if not node["ignored"] and node["role"]["value"] in USABLE
        }
        assert {role for role, _ in named} == USABLE
        assert all(name for _, name in named)
        assert ("slider", "Frame") in named
        page.evaluate(GO_TO.format(20))
        spoken = page.evaluate("document.querySelector('[data-part=\"time\"]').getAttribute('aria-valuetext')")
        assert spoken == "frame 27, 18.0 ms, before the first bounce"


def test_two_throws_of_a_notebook_play_side_by_side(tmp_path: Path) -> None:
    throw = made.throw()
    motion = motion_of("simulated", track_of(throw, made.FPS), throw)
    one = player_alone(made.die().solid, [motion], throw.bounces)
    other = player_alone(made.die().solid, [motion], Throw(throw.flights[:1], ()).bounces)
    file = tmp_path / "notebook.html"
    file.write_text(f'<!DOCTYPE html><meta charset="utf-8">{one}{other}', encoding="utf-8")
    with opened(file.as_uri(), tmp_path / "browser") as page:
        assert page.evaluate("document.querySelectorAll('.player[data-frame]').length") == 2
        assert page.errors == []
