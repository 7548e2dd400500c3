"""A rolling shutter that the scene leaves out shows in the shear of the die; a global one is never taken for one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, falling_cube, film, studio
from replay_records import ArrayClip

from diethrow.tracking.check.clip_quality import measure_clip_quality
from diethrow.tracking.check.shutter import LEAST_FRAMES, Readout
from diethrow.tracking.check.verdicts import Finding, Verdict, judge
from diethrow.tracking.sequence import ClipFacts

CUBE = DICE["cube"]
FRAMES = 48
READOUT_S = 0.6 / FPS


@cache
def readout_of(filmed_s: float, stated_s: float) -> tuple[Readout, Finding]:
    """What the check of a clip says, of a camera with one readout and a scene with another."""
    room = replace(studio(), noise_grey=2.0, readout_s=filmed_s)
    clip = film(room, CUBE, falling_cube(FRAMES / FPS), FRAMES)

    def part(first: int, stop: int) -> ArrayClip:
        return replace(clip, array=clip.array[first:stop], times_s=clip.times_s[first:stop], first_frame=first)

    facts = ClipFacts(1e-4, readout_s=stated_s)
    quality = measure_clip_quality(clip, room.camera, CUBE, part, background=np.rint(room.table), facts=facts)
    assert quality.tracked_part is not None
    assert quality.tracked_part.readout is not None
    found = {each.name: each for each in judge(quality, CUBE, 1e-4, readout_s=stated_s)}["shutter"]
    return quality.tracked_part.readout, found


@pytest.mark.parametrize("stated_s", [0.0, READOUT_S])
def test_the_readout_is_that_of_the_camera_whatever_the_scene_says(stated_s: float) -> None:
    readout, _ = readout_of(READOUT_S, stated_s)
    assert readout.frames >= LEAST_FRAMES
    # Bands of the filmed picture are interpolated, which is worth a few per cent.
    assert readout.readout_s == pytest.approx(READOUT_S, abs=max(4.0 * readout.sigma_s, 0.06 * READOUT_S))


def test_a_readout_that_is_left_out_is_bad_and_named() -> None:
    readout, found = readout_of(READOUT_S, 0.0)
    assert found.verdict is Verdict.BAD
    assert f"clip.readout_s = {readout.readout_s:.2g}" in found.advice


def test_a_readout_that_the_camera_does_not_have_is_doubtful() -> None:
    _, found = readout_of(0.0, READOUT_S)
    assert found.verdict is Verdict.DOUBTFUL
    assert "0.4 ms" in found.measured


@pytest.mark.parametrize("readout_s", [0.0, READOUT_S])
def test_the_right_readout_is_good(readout_s: float) -> None:
    assert readout_of(readout_s, readout_s)[1].verdict is Verdict.GOOD
