"""The table: at rest, tilted, or oscillating along its normal.

Everything is simulated in the table's own axes, with z along its normal. There gravity is (g_x, g_y, -g_n) and the
table stands at A sin(2πft + phase). The results are turned back into world axes. An impact changes the velocity
relative to the table (Kapitaniak et al., Chaos 22, 047504, 2012, obtain their largest exponents with an oscillating
table).

The bound on the acceleration that `throw.touch` uses includes the table's own, at most A (2πf)², so it covers every
table. A vertex above the highest point of the table's motion falls freely, whatever the table does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import engine
from ..errors import InputError
from ..rotations import matrix_from_quat, quat_from_rotvec
from ..world import GRAVITY_M_S2
from .impact_law import Array

MAX_TILT_RAD = 1.5
"""[rad] 86 degrees. A steeper table bears almost no normal force, and a die on it never comes to rest."""

MAX_FREQUENCY_HZ = 1e9
"""[Hz] At higher frequencies rounding of the time leaves no phase."""


MAX_DRAG_PER_M = 1e3
"""[1/m] A sheet of paper that falls flat has some 10. Above this, air is no thin fluid for the die."""


def checked_drag(drag_per_m: float) -> float:
    """The drag k [1/m] of v' = g - k |v| v. Raises ValueError outside 0 to MAX_DRAG_PER_M."""
    if not 0.0 <= drag_per_m <= MAX_DRAG_PER_M:
        raise InputError(f"drag_per_m = {drag_per_m}: wanted 0 to {MAX_DRAG_PER_M:g}, half of ρ c A/m in 1/m")
    return float(drag_per_m)


@dataclass(frozen=True)
class Table:
    """The plane through the origin on which a die falls; level and at rest by default."""

    tilt_rad: float = 0.0
    """Angle between the table's normal and the vertical."""
    downhill_rad: float = 0.0
    """Direction of steepest descent in the world's x-y plane, from x towards y."""
    amplitude_m: float = 0.0
    """A of the oscillation A sin(2πft + phase) along the normal, with t on the clock of the throw."""
    frequency_hz: float = 0.0
    phase_rad: float = 0.0
    gravity_m_s2: float = GRAVITY_M_S2
    """Of the place where it stands, along -z in world axes."""

    def __post_init__(self) -> None:
        for name in ("tilt_rad", "downhill_rad", "amplitude_m", "frequency_hz", "phase_rad", "gravity_m_s2"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"{name} = {getattr(self, name)}: wanted a finite number")
        if not self.gravity_m_s2 > 0.0:
            raise InputError(f"gravity_m_s2 = {self.gravity_m_s2}: wanted more than 0, in metres per second squared")
        if self.frequency_hz > MAX_FREQUENCY_HZ:
            raise InputError(f"frequency_hz = {self.frequency_hz}: wanted hertz, at most {MAX_FREQUENCY_HZ:g}")
        if abs(self.tilt_rad) > MAX_TILT_RAD:
            raise InputError(f"tilt_rad = {self.tilt_rad}: wanted radians, at most {MAX_TILT_RAD} either way")
        if self.amplitude_m < 0 or self.frequency_hz < 0:
            raise InputError(
                f"amplitude_m = {self.amplitude_m}, frequency_hz = {self.frequency_hz}: wanted 0 or more; "
                "for a negative amplitude add pi to the phase"
            )

    @property
    def moves(self) -> bool:
        """Whether it oscillates."""
        return self.amplitude_m > 0 and self.frequency_hz > 0

    @property
    def world_from_table(self) -> Array:
        """(4,) quaternion wxyz that takes the table's axes to world axes."""
        # A positive turn about the horizontal axis to the left of the downhill direction tilts the normal downhill.
        axis = np.array([-np.sin(self.downhill_rad), np.cos(self.downhill_rad), 0.0])
        return quat_from_rotvec(self.tilt_rad * axis)

    @property
    def plane(self) -> engine.Plane:
        """The record that the kernels take."""
        if self.tilt_rad:
            down = matrix_from_quat(self.world_from_table).T @ np.array([0.0, 0.0, -self.gravity_m_s2])
        else:
            down = np.array([0.0, 0.0, -self.gravity_m_s2])
        amplitude = self.amplitude_m if self.moves else 0.0
        rate = 2.0 * np.pi * self.frequency_hz
        return engine.Plane(float(down[0]), float(down[1]), float(-down[2]), amplitude, rate, self.phase_rad)

    def plane_in_air(self, drag_per_m: float) -> engine.Plane | engine.PlaneInAir:
        """The same with the drag k [1/m] of the air above the table, if there is any. Raises ValueError as `checked_drag`."""
        return engine.PlaneInAir(*self.plane, drag_per_m) if checked_drag(drag_per_m) > 0.0 else self.plane


LEVEL = Table()
"""Level and at rest."""
