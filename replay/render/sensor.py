"""The sensor of a high-speed camera: from light to electrons, noise and grey levels.

Light L (1.0 saturates the sensor) gives N = L (1 + u) n_full electrons, where u is the pixel's own deviation (photo
response non-uniformity). The signal is Poisson(N) + a normal deviate of the read noise + the pixel's own offset (dark signal
non-uniformity). It is rounded to whole levels, of which the largest corresponds to n_full: EMVA Standard 1288, Release 4.0,
section 2. Shot noise is a normal deviate of variance N, which above a few tens of electrons is equivalent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

Array = NDArray[np.float64]

MIN_BITS = 8
MAX_BITS = 16


@dataclass(frozen=True)
class Sensor:
    """A monochrome sensor; the defaults describe a common high-speed camera at base gain."""

    bit_depth: int = 8
    full_well_e: float = 15_000.0
    """Electrons at the largest grey level: 20 µm pixels hold 10 000 to 40 000."""
    read_noise_e: float = 25.0
    pixel_gain_sigma: float = 0.005
    """Relative standard deviation of the pixels' sensitivities."""
    pixel_offset_e: float = 15.0
    """Standard deviation of their offsets."""
    seed: int = 1
    """Seed of the pixels: equal seeds give the same sensor."""

    def __post_init__(self) -> None:
        if not MIN_BITS <= self.bit_depth <= MAX_BITS:
            raise InputError(f"bit_depth = {self.bit_depth}: wanted {MIN_BITS} to {MAX_BITS} bits, for example 8 or 12")
        if not (self.full_well_e > 0 and min(self.read_noise_e, self.pixel_gain_sigma, self.pixel_offset_e) >= 0):
            raise InputError(
                f"full_well_e = {self.full_well_e}, read_noise_e = {self.read_noise_e}, "
                f"pixel_gain_sigma = {self.pixel_gain_sigma}, pixel_offset_e = {self.pixel_offset_e}: "
                "wanted a full well above 0 and noises of 0 or more"
            )

    @property
    def top(self) -> int:
        """The largest grey level."""
        return int(2**self.bit_depth - 1)


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """The differences between the pixels of one sensor."""

    gain: Array
    """(height, width) relative sensitivity, near 1."""
    offset_e: Array
    """(height, width) [electrons]."""


def fixed_pattern(sensor: Sensor, height_px: int, width_px: int) -> FixedPattern:
    """The pixels of a sensor with this size."""
    rng = np.random.default_rng(sensor.seed)
    shape = (height_px, width_px)
    return FixedPattern(
        1.0 + sensor.pixel_gain_sigma * rng.standard_normal(shape), sensor.pixel_offset_e * rng.standard_normal(shape)
    )


def expose(sensor: Sensor, pattern: FixedPattern, light: Array, rng: np.random.Generator) -> Array:
    """Grey levels (height, width) before rounding, from light (height, width), of which 1.0 saturates the sensor."""
    electrons = np.maximum(light, 0.0) * pattern.gain * sensor.full_well_e
    noise_e = np.sqrt(electrons + sensor.read_noise_e**2) * rng.standard_normal(light.shape)
    return np.asarray((electrons + noise_e + pattern.offset_e) * (sensor.top / sensor.full_well_e))


def rounded(sensor: Sensor, levels: Array) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Whole grey levels, clipped to the sensor's range: uint8 for 8 bits, uint16 for more."""
    whole = np.clip(np.rint(levels), 0, sensor.top)
    return whole.astype(np.uint8) if sensor.bit_depth <= 8 else whole.astype(np.uint16)
