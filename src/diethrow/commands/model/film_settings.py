"""Settings of a film besides the throw and the scene: camera, lens, die, processing, codec and faults.

Fields are flat, so that presets and options can be combined by name; the properties gather them into values of
`replay.render`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...model.die import MAX_CORNER_RADIUS_FRACTION
from ...model.errors import InputError
from ...replay.render import Aperture, Codec, FrameFaults, Processing, RenderSettings, Sensor
from ...tracking.footage import Response, grey_of
from .film_presets import preset_values

MAX_FRAMES = 100_000
MAX_SIZE_PX = 8192
MIN_SIZE_PX = 16
NO_NOISE_WELL_E = 1e15
"""Full well of a sensor without noise [electrons]: its shot noise is far below a grey level."""


@dataclass(frozen=True)
class FilmSettings:
    """Settings of a film besides the throw and the scene."""

    # --- recording ---
    frames: int | None = None
    """Number of pictures that the camera takes; None for the whole throw."""
    start_s: float = 0.0
    """Time after the release at which the clip begins; its time is 0 there."""
    size_px: int = 512
    """Width and height without a scene."""
    fps: float | None = None
    """Recording rate; None for that of the scene or the throw file."""
    exposure_s: float | None = None
    """None for `exposure_share`, the exposure of the scene, or the default of a film."""
    exposure_share: float | None = None
    """The exposure as a share of the frame interval."""
    readout_s: float | None = None
    """Rolling shutter: from the first row's mid-exposure to the last row's. None for `readout_share`, or the scene's."""
    readout_share: float | None = None
    """The same as a share of the frame interval."""
    # --- sensor and file ---
    response: Response = None
    """How grey levels follow light; None for the response of the scene, or linear."""
    bit_depth: int = 8
    noise: float = 1.0
    """Factor on the sensor's read noise, fixed-pattern noise and shot noise; 0 for none."""
    codec: str = "ffv1"
    crf: int | None = None
    """Rate factor of H.264 and HEVC, quantiser of MJPEG; higher is worse."""
    full_range: bool = False
    """Whether the luma of H.264 and HEVC has full range."""
    turned_deg: int = 0
    """Angle by which players turn the stored frames, as MP4 states it."""
    # --- lens ---
    blur_px: float = 0.6
    """Standard deviation of the point spread function, pixel area included."""
    aperture_m: float = 0.0
    """Diameter of the aperture; 0 for a film that is sharp at every distance."""
    focus_m: float | None = None
    """Distance of the plane of focus along the camera's axis; None for that of the die at its first impact."""
    # --- die and light ---
    corner_radius_m: float | None = None
    """None for `corner_radius_share`, or that of the throw file."""
    corner_radius_share: float | None = None
    """The radius as a share of the inscribed radius of the die."""
    roughness: float | None = None
    """Of the die's gloss: 0.05 is nearly a mirror, 0.5 is dull."""
    lamp_side_m: float | None = None
    speckle: float = 0.0
    """Share of the faces that dark flakes cover."""
    translucency: float = 0.0
    """Share of the light that is refracted through the die."""
    mark_depth: float = 0.0
    """Depth of recessed marks, as a share of an edge."""
    edge_spread: float = 0.0
    """Relative difference of the longest and the shortest axis of the die that is seen."""
    second_die: bool = False
    """Whether another die is thrown beside the first."""
    # --- processing ---
    gain_drift: float = 0.0
    bayer: bool = False
    denoising: float = 0.0
    sharpening: float = 0.0
    shake_px: float = 0.0
    # --- the order of frames ---
    missing: float = 0.0
    doubled: float = 0.0
    frozen: float = 0.0
    # --- rendering ---
    samples: int = 48
    """Light paths per pixel of a frame."""
    seed: int = 1
    """Seed of textures, noise and light paths."""
    threads: int = 1
    variant: str = "scalar_rgb"
    """Variant of Mitsuba."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.noise) and self.noise >= 0):
            raise InputError(f"noise = {self.noise}: wanted a factor, 0 or more")
        grey_of(np.zeros(1), self.response)  # refuses an unknown one
        if self.frames is not None and not 1 <= self.frames <= MAX_FRAMES:
            raise InputError(f"frames = {self.frames}: wanted 1 to {MAX_FRAMES}")
        if not MIN_SIZE_PX <= self.size_px <= MAX_SIZE_PX:
            raise InputError(f"size_px = {self.size_px}: wanted {MIN_SIZE_PX} to {MAX_SIZE_PX}")
        if not (np.isfinite(self.start_s) and self.start_s >= 0):
            raise InputError(f"start_s = {self.start_s}: wanted a time of 0 or more, before the first impact")
        for name in ("fps", "exposure_s", "exposure_share", "focus_m", "roughness", "lamp_side_m"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} = {value}: wanted a finite number above 0")
        for name, most in SHARES.items():
            value = getattr(self, name)
            if value is not None and not 0 <= value <= most:
                raise InputError(f"{name} = {value}: wanted 0 to {most:g}")
        for name in ("readout_s", "corner_radius_m"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name} = {value}: wanted a finite number, 0 or more")
        self.stored_as.checked(self.bit_depth)
        _ = self.processing, self.faults, self.aperture(1.0)  # each refuses what it cannot be

    @property
    def rendering(self) -> RenderSettings:
        """Samples, threads and variant of the renderer."""
        return RenderSettings(self.samples, self.threads, self.variant)

    @property
    def stored_as(self) -> Codec:
        """The codec with its settings."""
        return Codec(self.codec, self.crf, self.full_range, self.turned_deg)

    @property
    def processing(self) -> Processing:
        """What the camera does with the frames."""
        return Processing(self.gain_drift, self.bayer, self.denoising, self.sharpening, self.shake_px)

    @property
    def faults(self) -> FrameFaults:
        """Faults of the order of frames."""
        return FrameFaults(self.missing, self.doubled, self.frozen)

    def aperture(self, die_at_m: float) -> Aperture:
        """The opening of the lens; it is focused at this distance unless the settings have one."""
        return Aperture(self.aperture_m, self.focus_m or die_at_m)

    @property
    def stretch(self) -> tuple[float, float, float]:
        """Factors on the body axes of the die that is seen."""
        return 1.0 + self.edge_spread / 2, 1.0, 1.0 - self.edge_spread / 2

    @property
    def sensor(self) -> Sensor:
        """The sensor with scaled noise."""
        ideal = Sensor(self.bit_depth, seed=self.seed)
        if self.noise == 0:
            return replace(
                ideal, full_well_e=NO_NOISE_WELL_E, read_noise_e=0.0, pixel_gain_sigma=0.0, pixel_offset_e=0.0
            )
        # Relative shot noise grows as the full well shrinks. Read noise and offsets are in electrons and scale with it.
        return replace(
            ideal,
            full_well_e=ideal.full_well_e / self.noise**2,
            read_noise_e=ideal.read_noise_e / self.noise,
            pixel_gain_sigma=ideal.pixel_gain_sigma * self.noise,
            pixel_offset_e=ideal.pixel_offset_e / self.noise,
        )


SHARES = {
    "exposure_share": 1.0,
    "readout_share": 1.0,
    "corner_radius_share": MAX_CORNER_RADIUS_FRACTION,
    "speckle": 0.9,
    "translucency": 1.0,
    "mark_depth": 0.2,
    "edge_spread": 0.2,
}
"""Largest value of each field that is a share, from 0."""


USUAL_SETTINGS = FilmSettings()
"""A linear high-speed camera with a global shutter, and the die of the throw file."""


def film_settings(presets: Sequence[str] = (), **explicit: Any) -> FilmSettings:
    """Settings from presets, the later ones winning, and from explicit values, of which None counts as not given.

    Raises ValueError for an unknown preset or an impossible value, TypeError for a field that does not exist.
    """
    given = {name: value for name, value in explicit.items() if value is not None}
    named = preset_values(presets)
    if "codec" in given:  # another codec's settings mean nothing to it
        named = {name: value for name, value in named.items() if name not in ("crf", "full_range", "turned_deg")}
    return FilmSettings(**named | given)


def response_named(text: str | None) -> Response:
    """The response that a word on the command line names: a number is an exponent. `FilmSettings` refuses unknown ones."""
    try:
        return text if text is None else float(text)
    except ValueError:
        return text
