"""Presets of a film: ordinary dice, ordinary cameras, and their faults, by name.

A preset gives values to some fields of `FilmSettings`. Several are combined in the order in which they are named, the later one
winning, and an explicit option wins over all of them. The list below is also the text of `film --list-presets` and of the
table in the documentation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from ...model.errors import InputError


@dataclass(frozen=True)
class Preset:
    """Some settings of a film under a name."""

    name: str
    sentence: str
    """What a film with it shows."""
    values: Mapping[str, Any]
    """Values of fields of `FilmSettings`."""


def _preset(name: str, sentence: str, **values: Any) -> Preset:
    return Preset(name, sentence, MappingProxyType(values))


PRESETS = (
    # --- cameras ---
    _preset(
        "phone",
        "Slow motion of a phone: 240 frames/s, a rolling shutter, the sRGB curve, mild sharpening and H.264.",
        fps=240.0,
        exposure_share=0.25,
        readout_share=0.75,
        response="srgb",
        sharpening=0.4,
        codec="h264",
        crf=20,
    ),
    _preset(
        "rolling-shutter", "Rows are exposed one after another, over 0.8 of the frame interval.", readout_share=0.8
    ),
    _preset("long-exposure", "Each frame is exposed for the whole frame interval.", exposure_share=1.0),
    _preset(
        "shallow-focus",
        "An aperture of 40 mm, focused where the die first strikes: surfaces blur with their distance from there.",
        aperture_m=0.04,
    ),
    _preset("noisy", "Three times the noise of a common high-speed camera at base gain.", noise=3.0),
    _preset("display-curve", "Grey levels follow the sRGB curve, as films for display do.", response="srgb"),
    _preset("bayer", "The raw mosaic of a colour sensor in grey: pixels keep their colour filters.", bayer=True),
    # --- what cameras do with frames ---
    _preset(
        "automatic-exposure",
        "The gain drifts from 0.83 to 1.2 times that of the background's picture.",
        gain_drift=0.2,
    ),
    _preset("sharpening-halos", "Sharpening gives every edge a bright and a dark halo.", sharpening=1.0),
    _preset(
        "temporal-denoising", "Noise is averaged over frames; moving edges of low contrast leave trails.", denoising=1.0
    ),
    _preset(
        "stabilisation",
        "A stabiliser moves the picture by 1 px (standard deviation) along a slow random walk.",
        shake_px=1.0,
    ),
    # --- codecs ---
    _preset("h264", "Stored as H.264 in MP4, CRF 20, limited range.", codec="h264", crf=20),
    _preset("hevc", "Stored as HEVC in MP4, CRF 22, limited range.", codec="hevc", crf=22),
    _preset("mjpeg", "Stored as motion JPEG in AVI, quantiser 4, full range.", codec="mjpeg", crf=4),
    _preset("low-bitrate", "Stored as H.264 with CRF 34, as sent by a messenger.", codec="h264", crf=34),
    _preset(
        "turned",
        "Stored as H.264 on its side, with the rotation for players in the MP4, as by a phone held upright.",
        codec="h264",
        crf=20,
        turned_deg=90,
    ),
    # --- dice ---
    _preset(
        "glossy",
        "A polished die below a soft box of 20 cm: highlights clip at full scale.",
        roughness=0.05,
        lamp_side_m=0.2,
    ),
    _preset("rounded", "Corners and edges are rounded by a quarter of the inscribed radius.", corner_radius_share=0.25),
    _preset("very-rounded", "Corners and edges are rounded by half the inscribed radius.", corner_radius_share=0.5),
    _preset(
        "translucent",
        "Clear resin: most light is refracted through the die, which shows the table and its own far edges.",
        translucency=0.6,
        roughness=0.15,
        lamp_side_m=0.2,
    ),
    _preset("speckled", "Dark flakes cover a quarter of every face.", speckle=0.25),
    _preset(
        "recessed-pips",
        "Marks are bowls, 3 % of an edge deep, with their own shading; pips or numbers on a plain die.",
        mark_depth=0.03,
    ),
    _preset(
        "unequal-edges",
        "The die that is seen has edges that differ by 1 %; it moves as the regular one of the scene.",
        edge_spread=0.01,
    ),
    _preset("second-die", "A second, equal die is thrown beside the first, and never touches it.", second_die=True),
    # --- the order of frames ---
    _preset(
        "missing-frames", "2 % of the frames, at least one, are missing from a file without time stamps.", missing=0.02
    ),
    _preset("doubled-frames", "2 % of the frames, at least one, are stored twice.", doubled=0.02),
    _preset(
        "frozen-frames",
        "After 2 % of the frames, at least one, the film stands still for three frames, which are lost.",
        frozen=0.02,
    ),
)
"""All presets, by subject."""


def preset_values(names: Sequence[str]) -> dict[str, Any]:
    """The values of several presets, of which a later one wins. Raises ValueError for an unknown name."""
    known = {preset.name: preset for preset in PRESETS}
    values: dict[str, Any] = {}
    for name in names:
        if name not in known:
            raise InputError(f"preset {name!r}: wanted one of {', '.join(known)}")
        values |= known[name].values
    return values


def preset_rows() -> list[tuple[str, str]]:
    """Name and sentence of every preset."""
    return [(preset.name, preset.sentence) for preset in PRESETS]
