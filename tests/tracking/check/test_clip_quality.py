"""Laws of the check before tracking: it measures the quality of a clip, and reports its faults."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, falling_cube, film, studio
from replay_records import ArrayClip

from diethrow.model.die.die import Die, make_die
from diethrow.model.throw.motion import Throw
from diethrow.model.world import GRAVITY_M_S2
from diethrow.tracking.camera import Camera
from diethrow.tracking.check.clip_quality import (
    BackgroundMatch,
    ClipQuality,
    FrameTiming,
    TrackedPart,
    measure_clip_quality,
)
from diethrow.tracking.check.gravity import Fall
from diethrow.tracking.check.verdicts import Finding, Verdict, judge
from diethrow.tracking.sequence import ClipFacts
from diethrow.tracking.track import LOST, TRACKED, Track

ROOM = replace(studio(), noise_grey=2.0, shadow=0.3, blur_px=0.8)
CUBE = DICE["cube"]
FRAMES = 64


@cache
def falling() -> tuple[ArrayClip, Throw]:
    """A cube that comes down and bounces once, at frame 36.5."""
    throw = falling_cube(FRAMES / FPS)
    return film(ROOM, CUBE, throw, FRAMES), throw


def measured(clip: ArrayClip, camera: Camera = ROOM.camera, die: Die = CUBE) -> ClipQuality:
    def part(first: int, stop: int) -> ArrayClip:
        return replace(clip, array=clip.array[first:stop], times_s=clip.times_s[first:stop], first_frame=first)

    return measure_clip_quality(clip, camera, die, part, background=np.rint(ROOM.table), facts=ClipFacts(1e-4))


@cache
def quality_of_falling_cube() -> ClipQuality:
    return measured(falling()[0])


def finding(name: str, found: ClipQuality, die: Die = CUBE, exposure_s: float | None = 1e-4) -> Finding:
    return next(each for each in judge(found, die, exposure_s) if each.name == name)


def test_a_clip_without_faults_is_good_in_every_respect() -> None:
    faults = [each for each in judge(quality_of_falling_cube(), CUBE, 1e-4) if each.verdict is Verdict.BAD]
    assert faults == []
    for name in ("timing", "background", "light", "die", "pixels", "motion blur", "sharpness"):
        assert finding(name, quality_of_falling_cube()).verdict is Verdict.GOOD


def test_size_and_blur_are_those_of_the_rendered_clip() -> None:
    tracked_part = quality_of_falling_cube().tracked_part
    assert tracked_part is not None
    # The studio's dice are 80 px from corner to corner, a cube seen face on 60 less a little by its distance.
    assert 50 < tracked_part.diameter_px[0] <= tracked_part.diameter_px[1] < 100
    # The trial widths lie a third apart, and a parabola through three of them finds the middle to a few hundredths.
    assert tracked_part.lens_blur_px == pytest.approx(0.8, abs=0.12)
    assert tracked_part.motion_blur_px is not None
    assert tracked_part.motion_blur_px[1] == pytest.approx(tracked_part.shift_px * 1e-4 * FPS, rel=0.01)
    assert tracked_part.saturated_share == 0.0


def test_gravity_and_the_table_lie_within_their_intervals() -> None:
    tracked_part = quality_of_falling_cube().tracked_part
    assert tracked_part is not None
    assert tracked_part.fall is not None
    off = tracked_part.fall.acceleration_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2])
    # Chi-square with three degrees of freedom lies below 14.2 in 99.7 % of the cases.
    assert off @ np.linalg.solve(tracked_part.fall.covariance, off) < 14.2
    assert len(tracked_part.contact_height_m) == len(falling()[1].impacts) == 1
    assert np.abs(tracked_part.contact_height_m[0]) < 4.0 * max(tracked_part.contact_sigma_m[0], 5e-5)


def test_a_wrong_edge_shows_in_the_fall_which_gives_the_right_one() -> None:
    wrong = make_die("cube", 0.93 * CUBE.solid.edge_m, CUBE.mass_kg)
    found = finding("scale", measured(falling()[0], die=wrong), wrong)
    assert found.verdict is not Verdict.GOOD
    edge, half = found.values["edge_from_fall_m"], found.values["edge_from_fall_half_width_m"]
    assert edge is not None
    assert half is not None
    assert abs(edge - CUBE.solid.edge_m) < 1.5 * half  # 1.5 × 1.96 sigmas: 0.3 % of the cases lie beyond


def test_a_clip_without_a_die_is_bad() -> None:
    clip, _ = falling()
    rng = np.random.default_rng(3)
    empty = np.clip(np.rint(ROOM.table + rng.normal(0, 2, (20, *ROOM.table.shape))), 0, 255).astype(np.uint8)
    found = measured(replace(clip, array=empty, times_s=clip.times_s[:20]))
    assert found.tracked_part is None
    assert finding("die", found).verdict is Verdict.BAD
    assert "No die" in finding("die", found).measured


# --- verdicts, from numbers alone ---


def numbers(**changes: object) -> ClipQuality:
    """The quality of a clip without faults, but for some changes."""
    rows = np.arange(60)
    track = Track(
        rows, rows / FPS, np.zeros((60, 3)), np.tile([1.0, 0, 0, 0], (60, 1)), np.tile(1e-9 * np.eye(6), (60, 1, 1)),
        np.array([TRACKED] * 60),
    )  # fmt: skip
    fall = Fall(np.array([0.0, 0.0, -GRAVITY_M_S2]), 1e-4 * np.eye(3))
    parts = {
        TrackedPart: TrackedPart(
            track, None, (80.0, 90.0), (0.3, 0.5), 5.0, 0.7, 0.0, fall, np.array([1e-5]), np.array([2e-5])
        ),
        FrameTiming: FrameTiming(60, FPS, None, 30.0, None, 0.0, ()),
        BackgroundMatch: BackgroundMatch(False, 2.0, 0.1, 0.001, 0.8),
    }
    own = {kind: {k: v for k, v in changes.items() if k in kind.__dataclass_fields__} for kind in parts}
    tracked_part, timing, background_match = (replace(part, **own[kind]) for kind, part in parts.items())
    return ClipQuality(timing, background_match, tracked_part, "")


def tilted(degrees: float, share: float = 1.0, sigma: float = 0.01) -> Fall:
    angle = np.radians(degrees)
    down = -GRAVITY_M_S2 * share * np.array([np.sin(angle), 0.0, np.cos(angle)])
    return Fall(down, sigma**2 * np.eye(3))


@pytest.mark.parametrize(
    ("name", "changes", "verdict", "words"),
    [
        ("timing", {}, Verdict.GOOD, "playback rate of 30"),
        (
            "timing",
            {"notices": ("x: 2 of 9 frames are exact copies of the one before (3, 4)",)},
            Verdict.BAD,
            "exact copies",
        ),
        ("timing", {"uneven_share": 0.4}, Verdict.DOUBTFUL, "vary by 40 %"),
        ("timing", {"file_exposure_s": 2e-4}, Verdict.DOUBTFUL, "200 µs by the file"),
        ("background", {"differing_share": 0.4}, Verdict.BAD, "40 % of the pixels"),
        ("background", {"offset_grey": 7.0}, Verdict.DOUBTFUL, "+7 grey levels"),
        ("light", {"saturated_share": 0.2}, Verdict.BAD, "20 %"),
        ("light", {"saturated_share": 0.01}, Verdict.DOUBTFUL, "1 %"),
        ("light", {"brightest_share": 0.05}, Verdict.DOUBTFUL, "5 % of full scale"),
        ("pixels", {"diameter_px": (12.0, 20.0)}, Verdict.BAD, "12 to 20 px"),
        ("pixels", {"diameter_px": (40.0, 60.0)}, Verdict.DOUBTFUL, "40 to 60 px"),
        ("motion blur", {"motion_blur_px": (2.0, 9.0)}, Verdict.BAD, "9 px at the most"),
        ("motion blur", {"motion_blur_px": (2.0, 3.0)}, Verdict.DOUBTFUL, "2 px in the median"),
        ("motion blur", {"motion_blur_px": None}, Verdict.DOUBTFUL, "exposure"),
        ("motion blur", {"shift_px": 40.0}, Verdict.DOUBTFUL, "moves 40 px a frame"),
        ("sharpness", {"lens_blur_px": 2.6}, Verdict.BAD, "2.6 px"),
        ("sharpness", {"lens_blur_px": 1.8}, Verdict.DOUBTFUL, "1.8 px"),
        ("scale", {"fall": tilted(0.0)}, Verdict.GOOD, "9.81"),
        ("scale", {"fall": tilted(0.0, 1.1)}, Verdict.BAD, "10.79"),
        ("scale", {"fall": tilted(0.0, 1.02)}, Verdict.DOUBTFUL, "10.01"),
        ("scale", {"fall": tilted(0.0, 1.1, 2.0)}, Verdict.DOUBTFUL, "10.79"),
        ("scale", {"fall": None}, Verdict.DOUBTFUL, "No flight"),
        ("vertical", {"fall": tilted(3.0)}, Verdict.BAD, "3 ±"),
        ("vertical", {"fall": tilted(1.0)}, Verdict.DOUBTFUL, "1 ±"),
        ("vertical", {"fall": tilted(0.1)}, Verdict.GOOD, "0.1 ±"),
        ("table", {"contact_height_m": np.array([3e-3])}, Verdict.BAD, "z = +3 "),
        ("table", {"contact_height_m": np.array([-1e-3])}, Verdict.DOUBTFUL, "z = -1 "),
        ("table", {"contact_height_m": np.array([])}, Verdict.DOUBTFUL, "No bounce"),
    ],
)
def test_every_fault_has_its_verdict_its_number_and_what_to_change(
    name: str, changes: dict[str, object], verdict: Verdict, words: str
) -> None:
    found = finding(name, numbers(**changes))
    assert found.verdict is verdict
    assert words in found.measured
    assert bool(found.advice) == (verdict is not Verdict.GOOD)


def test_a_wrong_edge_and_a_wrong_rate_are_reported_with_their_factors() -> None:
    found = finding("scale", numbers(fall=tilted(0.0, 1.21)))
    # The die falls with k g where the edge is k times too large, and with k² g where the rate is k times too large.
    assert "the lengths of [die] by 0.8264" in found.advice
    assert "clip.fps by 0.9091" in found.advice


def test_a_die_that_is_lost_on_many_frames_is_reported() -> None:
    tracked_part = numbers().tracked_part
    assert tracked_part is not None
    for lost, verdict in ((40, Verdict.BAD), (10, Verdict.DOUBTFUL), (2, Verdict.GOOD)):
        track = replace(tracked_part.track, status=np.array([LOST] * lost + [TRACKED] * (60 - lost)))
        assert finding("die", numbers(track=track)).verdict is verdict
