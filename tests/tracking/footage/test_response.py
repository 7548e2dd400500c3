"""Laws of a clip mapped from grey levels to light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_pictures
from replay_records import ArrayClip, coded_clip

from diethrow.tracking.footage.clip import FillsFrames, open_clip
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.footage.response import (
    Response,
    clip_in_light,
    grey_of,
    is_linear,
    level_grey,
    light_of,
    light_table,
    picture_in_light,
)

CURVES: list[Response] = ["srgb", 0.2, 0.45, 0.7, 1.5]


@pytest.mark.parametrize("bit_depth", [8, 10, 12, 16])
@pytest.mark.parametrize("response", CURVES)
def test_the_table_is_monotone_and_exact_at_both_ends(response: Response, bit_depth: int) -> None:
    table, full = light_table(bit_depth, response), 2**bit_depth - 1
    assert (np.diff(table.astype(int)) >= 0).all()
    assert table[0] == 0
    # The tracker finds saturated pixels by the full scale of the clip's depth.
    clip = clip_in_light(coded_clip(2, bit_depth=bit_depth), response)
    assert (table[full:] == 2**clip.bit_depth - 1).all()
    assert len(table) == (256 if bit_depth <= 8 else 65536)


def test_light_undoes_the_curves() -> None:
    light = np.linspace(0.0, 1.0, 101)
    for response in (*CURVES, "linear", None):
        np.testing.assert_allclose(light_of(grey_of(light, response), response), light, atol=1e-7)
    np.testing.assert_allclose(grey_of(light, 0.45), light**0.45)
    # Middle grey of 18 % is level 118 of 255 in sRGB.
    assert 255.0 * grey_of(np.array([0.18]), "srgb")[0] == pytest.approx(117.7, abs=0.1)


@pytest.mark.parametrize("response", [None, "linear", 1.0, 1])
def test_a_linear_response_maps_nothing(response: Response) -> None:
    clip, picture = coded_clip(3), np.ones((4, 5), np.float32)
    assert is_linear(response)
    assert clip_in_light(clip, response) is clip
    assert picture_in_light(picture, clip, response) is picture
    assert level_grey(clip, response) == 1.0


@pytest.mark.parametrize("response", [0.0, -1.0, 0.19, 1.51, 2.2, float("nan"), "rec709"])
def test_an_unknown_response_is_refused(response: Response) -> None:
    with pytest.raises(ValueError, match=r"wanted one of linear, srgb, or an exponent from 0\.2 to 1\.5"):
        clip_in_light(coded_clip(2), response)


@pytest.mark.parametrize("bits", [8, 12])
def test_every_way_to_read_gives_the_mapped_frames(bits: int, tmp_path: Path) -> None:
    raw = open_clip(write_pictures(tmp_path / "p", noisy_frames(6, bits=bits)), fps=1500)
    light, table = clip_in_light(raw, 0.45), light_table(raw.bit_depth, 0.45)
    wanted = np.stack([table[frame] for frame in raw.frames()])
    assert wanted.dtype == np.uint16
    assert (len(light), light.first_frame, light.metadata()) == (len(raw), raw.first_frame, raw.metadata())
    assert light.notices == raw.notices
    np.testing.assert_array_equal(np.stack(list(light.frames(1, 4))), wanted[1:4])
    np.testing.assert_array_equal(light.frame(5), wanted[5])
    np.testing.assert_array_equal(np.concatenate([b.frames[:, 0] for b in FrameSource([light]).blocks()]), wanted)
    assert isinstance(light, FillsFrames)
    assert light.in_any_order
    out = np.zeros((2, raw.height_px, raw.width_px), np.uint16)
    light.fill(2, out, np.array([[3, 4, 20, 30], [0, 0, 0, 0]]))
    np.testing.assert_array_equal(out[0, 4:30, 3:20], wanted[2, 4:30, 3:20])
    light.fill(2, out)
    np.testing.assert_array_equal(out, wanted[2:4])


def test_a_clip_that_fills_no_frames_is_read_in_order() -> None:
    clip = clip_in_light(ArrayClip(noisy_frames(3), np.arange(3) / 1500.0), "srgb")
    assert not isinstance(clip, FillsFrames)
    assert len(list(clip.frames())) == 3


@pytest.mark.parametrize("response", CURVES)
def test_a_background_is_mapped_as_the_frames_are(response: Response) -> None:
    clip = ArrayClip(noisy_frames(2), np.arange(2) / 1500.0)
    background = picture_in_light(clip.frame(0).astype(np.float32), clip, response)
    assert np.abs(background - clip_in_light(clip, response).frame(0)).max() <= 0.501
