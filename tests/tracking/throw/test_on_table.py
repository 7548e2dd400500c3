"""Laws of frames on the table: what they say of the distance, and where a die hops between them."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from diethrow.model.die.die import make_die
from diethrow.model.rotations import quat_from_rotvec
from diethrow.model.world import GRAVITY_M_S2
from diethrow.tracking.flights.flight_chain import TABLE_SIGMA_M
from diethrow.tracking.throw.rest import on_table
from diethrow.tracking.track import TRACKED, Track

Array = NDArray[np.float64]

DIE = make_die("cube", 0.016, 0.0048, corner_radius_m=0.001)
TIME_S = np.arange(40) / 250.0
ROWS = np.arange(len(TIME_S))
SIGHT = np.array([0.0, np.cos(np.radians(12.0)), -np.sin(np.radians(12.0))])
"""Line of sight of a camera that looks from 12 degrees above the table."""


def seen_on_the_table(height_m: Array, along_m: Array) -> tuple[Track, Array]:
    """A track of a die that lies on a face, at heights (n,) and ways (n,) along the table away from the camera, and its true
    positions. All distances have the error of 2 mm, of stated 3 mm."""
    n, rng = len(TIME_S), np.random.default_rng(7)
    true = np.stack([np.zeros(n), along_m, DIE.solid.inradius + height_m], axis=1)
    covariance = np.diag([1e-5] * 3 + [1e-3] * 3) ** 2
    covariance[:3, :3] += 3e-3**2 * np.outer(SIGHT, SIGHT)
    seen = true + 2e-3 * SIGHT + rng.normal(scale=1e-5, size=(n, 3))
    turned = quat_from_rotvec(rng.normal(scale=1e-3, size=(n, 3)))
    return Track(ROWS, TIME_S, seen, turned, np.tile(covariance, (n, 1, 1)), np.full(n, TRACKED)), true


def distance_errors(track: Track, true: Array) -> tuple[Array, Array]:
    """(n,) of the poses on the table [m], and in their standard errors."""
    found = on_table(track, ROWS, DIE, 0.0, TABLE_SIGMA_M)
    far = (found.position_m - true) @ SIGHT
    return far, far / np.sqrt(np.einsum("i,nij,j->n", SIGHT, found.covariance[:, :3, :3], SIGHT))


def test_hops_of_a_few_frames_are_not_pressed_onto_the_table() -> None:
    """Of 24, 20 and 12 ms, 0.7, 0.5 and 0.2 mm high, the first seen from its middle on. A die that hops, taken for one on the
    table, would be 3 mm farther away."""
    height = np.zeros(len(TIME_S))
    for begin_s, end_s in ((-0.013, 0.011), (0.011, 0.031), (0.031, 0.043)):
        height = np.maximum(height, 0.5 * GRAVITY_M_S2 * (TIME_S - begin_s) * (end_s - TIME_S))
    track, true = seen_on_the_table(height, np.zeros(len(TIME_S)))
    far, sigmas = distance_errors(track, true)
    assert np.abs(sigmas).max() < 3.0
    # The table still says how far away the die is: within tenths of a millimetre behind the hops.
    assert np.abs(far).max() < 1.7e-3
    assert np.abs(far[12:]).max() < 3e-4
    with patch("diethrow.tracking.throw.rest._hop_heights_m", return_value=np.zeros(len(TIME_S))):
        far, sigmas = distance_errors(track, true)
    assert np.abs(far).max() > 2.5e-3
    assert np.abs(sigmas).max() > 5.0


def test_a_die_that_friction_stops_does_not_hop() -> None:
    """It slides at 0.3 m/s away from the camera, and stops within 60 ms."""
    slid_s = np.minimum(TIME_S, 0.06)
    track, true = seen_on_the_table(np.zeros(len(TIME_S)), 0.3 * slid_s - 2.5 * slid_s**2)
    far, _ = distance_errors(track, true)
    assert np.abs(far).max() < 3e-4
