"""The constants of the world in which dice fall."""

from __future__ import annotations

GRAVITY_M_S2 = 9.81
"""[m/s²] Acceleration of gravity where nothing else is said, along -z: (0, 0, -9.81) in world axes."""
