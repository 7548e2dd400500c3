"""model.world."""

from __future__ import annotations

GRAVITY_M_S2 = 9.81
"""Downwards along -z: gravity is (0, 0, -9.81) m/s²."""
