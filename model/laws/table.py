"""Tables: at rest, tilted, or oscillating along the normal.

Everything is simulated in the table's own axes, z along its normal, where gravity is (g_x, g_y, -g_n) and the table
stands at A sin(2πft + phase); the results are turned back into world axes. An impact changes the velocity relative to
the table (Kapitaniak et al., Chaos 22, 047504, 2012, use the oscillating one for their largest exponents). The bound of
`touch` takes the table's own acceleration, at most A (2πf)², and so covers every table; and a vertex above the highest
point of the table's motion falls freely, whatever the table does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..rotations import matrix_from_quat, quat_from_rotvec
from ..world import GRAVITY_M_S2

Array = NDArray[np.float64]

STEEPEST_RAD = 1.5
"""Of a tilted table: 86 degrees, beyond which nothing presses on it."""

FASTEST_HZ = 1e9
"""Of an oscillating table: beyond it rounding of the time leaves no phase."""


@dataclass(frozen=True)
class Table:
    """The plane through the origin on which a die falls; at rest and level unless it is told otherwise."""

    tilt_rad: float = 0.0
    """Angle between the table's normal and the vertical."""
    downhill_rad: float = 0.0
    """Direction in which it falls, in the world's x-y plane, from x towards y."""
    amplitude_m: float = 0.0
    """Of its oscillation along its normal: A sin(2πft + phase), t the time on the clock of the throw."""
    frequency_hz: float = 0.0
    phase_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("tilt_rad", "downhill_rad", "amplitude_m", "frequency_hz", "phase_rad"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)}: wanted a finite number")
        if self.frequency_hz > FASTEST_HZ:
            raise ValueError(f"frequency_hz = {self.frequency_hz}: wanted hertz, at most {FASTEST_HZ:g}")
        if abs(self.tilt_rad) > STEEPEST_RAD:
            raise ValueError(f"tilt_rad = {self.tilt_rad}: wanted radians, at most {STEEPEST_RAD} either way")
        if self.amplitude_m < 0 or self.frequency_hz < 0:
            raise ValueError(
                f"amplitude_m = {self.amplitude_m}, frequency_hz = {self.frequency_hz}: wanted 0 or more; "
                "turn the phase by pi for an amplitude below 0"
            )

    @property
    def moves(self) -> bool:
        """Whether it oscillates at all."""
        return self.amplitude_m > 0 and self.frequency_hz > 0

    @property
    def world_from_table(self) -> Array:
        """(4,) quaternion wxyz that takes the table's axes to world axes."""
        # About the horizontal axis to the left of the way down; the table's z leans downhill.
        axis = np.array([-np.sin(self.downhill_rad), np.cos(self.downhill_rad), 0.0])
        return quat_from_rotvec(self.tilt_rad * axis)

    @property
    def plane(self) -> engine.Plane:
        """The table as the kernels have it."""
        if self.tilt_rad:
            down = matrix_from_quat(self.world_from_table).T @ np.array([0.0, 0.0, -GRAVITY_M_S2])
        else:
            down = np.array([0.0, 0.0, -GRAVITY_M_S2])
        amplitude = self.amplitude_m if self.moves else 0.0
        rate = 2.0 * np.pi * self.frequency_hz
        return engine.Plane(float(down[0]), float(down[1]), float(-down[2]), amplitude, rate, self.phase_rad)


LEVEL = Table()
"""At rest and level."""
