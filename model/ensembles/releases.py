"""Releases of an ensemble: how initial conditions are drawn, and how they become states.

**Reproducible.** Throw number k of a seed is the same throw whatever the number of threads, the size of the chunks or
the number of throws. Random numbers are drawn in blocks of BLOCK throws, block b with a Philox generator of its own
(Salmon et al., SC11, 2011) seeded by (seed, b).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from ..die import Die
from ..errors import InputError

Array = NDArray[np.float64]

BLOCK = 4096
"""Throws that share one generator. It is part of what a seed means: another number gives other throws."""

CONDITIONS = ("z0", "psi", "theta", "phi", "vx", "vy", "vz", "omega_xi", "omega_eta", "omega_zeta")
"""The paper's initial conditions: height [m], Euler angles [rad], velocity [m/s], body-frame spin [rad/s]. Nothing depends
on x0 and y0, so they are left out."""


HEIGHT_EDGES = (15.0, 20.0)
"""Default range of the release height in edges of the die: that of the paper."""


class Conditions(Protocol):
    """A distribution of releases."""

    def lowest_m(self, die: Die) -> float:
        """The lowest height [m] of the die's centre at release."""
        ...

    def states(self, die: Die, count: int, random: np.random.Generator) -> Array:
        """Releases (count, 13): position, quaternion wxyz, velocity, angular velocity, world axes."""
        ...


@dataclass(frozen=True)
class PaperConditions:
    """As in Kapitaniak et al. (2012): z0 uniform (there in [15 a, 20 a]), Euler angles uniform in [0, 2π], no velocity.

    Such angles are not uniform over orientations: the body's ζ axis is near the vertical too often.
    """

    omega_body_rad_s: tuple[float, float, float]
    """(ω_ξ, ω_η, ω_ζ), the same for every throw."""
    height_m: tuple[float, float]
    """Range of z0."""

    def __post_init__(self) -> None:
        _check_finite("omega_body_rad_s", self.omega_body_rad_s)
        _check_range("height_m", self.height_m)

    def lowest_m(self, die: Die) -> float:
        """As `Conditions.lowest_m`."""
        return self.height_m[0]

    def states(self, die: Die, count: int, random: np.random.Generator) -> Array:
        """As `Conditions.states`."""
        drawn = random.random((count, 4))
        numbers = np.zeros((count, len(CONDITIONS)))
        low, high = self.height_m
        numbers[:, 0] = low + (high - low) * drawn[:, 0]
        numbers[:, 1:4] = 2.0 * np.pi * drawn[:, 1:]
        numbers[:, 7:10] = self.omega_body_rad_s
        return states_of(numbers)


@dataclass(frozen=True)
class UniformConditions:
    """Orientation uniform over all rotations, a spin of given magnitude in a uniform direction, no velocity."""

    spin_rad_s: float
    height_m: tuple[float, float]
    """Range of the height of the centre, uniform within."""

    def __post_init__(self) -> None:
        _check_finite("spin_rad_s", (self.spin_rad_s,))
        _check_range("height_m", self.height_m)

    def lowest_m(self, die: Die) -> float:
        """As `Conditions.lowest_m`."""
        return self.height_m[0]

    def states(self, die: Die, count: int, random: np.random.Generator) -> Array:
        """As `Conditions.states`."""
        low, high = self.height_m
        states = np.zeros((count, 13))
        states[:, 2] = low + (high - low) * random.random(count)
        # Four normal numbers have no preferred direction (Muller, Comm. ACM 2, 19, 1959).
        quaternions, axes = random.normal(size=(count, 4)), random.normal(size=(count, 3))
        states[:, 3:7] = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        states[:, 10:13] = self.spin_rad_s * axes / np.linalg.norm(axes, axis=1, keepdims=True)
        return states


def drawn_states(conditions: Conditions, die: Die, seed: int, first: int, end: int) -> Array:
    """Releases (end - first, 13) number `first` to `end` - 1 of a seed, the same for every split into ranges."""
    parts = []
    for block in range(first // BLOCK, -(-end // BLOCK)):
        random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(block,))))
        states = conditions.states(die, BLOCK, random)
        parts.append(states[max(first - block * BLOCK, 0) : end - block * BLOCK])
    return np.concatenate(parts) if parts else np.empty((0, 13))


def states_of(numbers: Array) -> Array:
    """Releases (n, 13), in world axes, of the paper's initial conditions (n, 10) in the order of CONDITIONS."""
    states = np.zeros((len(numbers), 13))
    _fill_states(np.ascontiguousarray(numbers, float), states)
    return states


def _check_finite(name: str, values: tuple[float, ...]) -> None:
    """Raise ValueError, naming the quantity, unless all values are finite."""
    if not np.isfinite(values).all():
        raise InputError(f"{name} = {values}: wanted finite numbers")


def _check_range(name: str, values: tuple[float, float]) -> None:
    """Raise ValueError, naming the quantity, unless it is a finite range."""
    _check_finite(name, values)
    if values[0] > values[1]:
        raise InputError(f"{name} = {values}: wanted the lower bound first")


@compiled
def _fill_states(numbers: Array, states: Array) -> None:
    """Element by element, so that a release does not depend on its neighbours in the array, not even in the last bit."""
    for k in range(numbers.shape[0]):
        psi, theta, phi = 0.5 * numbers[k, 1], 0.5 * numbers[k, 2], 0.5 * numbers[k, 3]
        # R = Rz(ψ) Rx(ϑ) Rz(φ)
        w, x = cos(theta) * cos(psi + phi), sin(theta) * cos(psi - phi)
        y, z = sin(theta) * sin(psi - phi), cos(theta) * sin(psi + phi)
        a, b, c = numbers[k, 7], numbers[k, 8], numbers[k, 9]
        tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        states[k, 2] = numbers[k, 0]
        states[k, 3], states[k, 4], states[k, 5], states[k, 6] = w, x, y, z
        states[k, 7], states[k, 8], states[k, 9] = numbers[k, 4], numbers[k, 5], numbers[k, 6]
        states[k, 10] = a + w * tx + y * tz - z * ty
        states[k, 11] = b + w * ty + z * tx - x * tz
        states[k, 12] = c + w * tz + x * ty - y * tx
