"""Laws of the corner radius by impacts: a sharp die stays sharp, and a rounded one that looks sharp strikes as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import studio
from throws import DICE, random_release, seen, true_throw

from diethrow.model.die.die import Die
from diethrow.model.rotations import matrix_from_quat
from diethrow.model.throw.motion import Throw
from diethrow.tracking.clip_parameters.radius_by_impacts import OPEN_CONTOUR_PX, flies_as_before, radius_by_impacts
from diethrow.tracking.throw.measurement import measure
from diethrow.tracking.throw.shared_bias import outline_growth, shared_bias_jacobian
from diethrow.tracking.track import LOST, Track

CAMERA = studio(400, 400).camera
CUBE, _, ICOSAHEDRON = DICE


def filmed(die: Die, seed: int, inset_px: float) -> tuple[Track, Throw]:
    """A throw, and its poses if the contour lies within that of a sharp die: they are too far away."""
    rng = np.random.default_rng(seed)
    throw = true_throw(die, random_release(die, rng), 0.6, impacts=2)
    track = seen(throw, rng)
    by_contour = shared_bias_jacobian(track, CAMERA, replace(die, corner_radius_m=0.0))[:, :, :1]
    farther = track.position_m - inset_px * by_contour[:, :3, 0]
    return replace(track, position_m=farther, bias_jacobian=by_contour), throw


def inset_px(die: Die, throw: Throw) -> float:
    """How far the contour of a rounded die lies within that of a sharp one, on average."""
    p, q = throw.poses(np.linspace(0.0, throw.flights[-1].end_s, 50))
    growth = outline_growth(CAMERA, die, p, matrix_from_quat(q))
    scale = CAMERA.matrix[0, 0] / np.linalg.norm(p - CAMERA.centre_m, axis=1)
    return float(np.median(die.corner_radius_m * (1.0 / (growth * die.solid.inradius) - scale)))


def distance_error_m(track: Track, die: Die, throw: Throw) -> float:
    """Median error of the flights along the line of sight."""
    found = measure(track, die, CAMERA).throw_without_shared_errors
    off = throw.poses(track.time_s)[0] - found.poses(track.time_s)[0]
    return float(np.median(np.abs(off @ CAMERA.rotation[2])))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("die", DICE, ids=lambda die: die.solid.name)
def test_impacts_of_a_sharp_die_show_no_radius(die: Die, seed: int) -> None:
    assert radius_by_impacts(filmed(die, seed, 0.0)[0], die, CAMERA) == (None, 0.0)


@pytest.mark.parametrize(
    ("sharp", "radius_m", "seed"),
    [(CUBE, 0.5e-3, 1), (CUBE, 0.5e-3, 2), (CUBE, 0.5e-3, 4), (ICOSAHEDRON, 1.0e-3, 1)],
)
def test_a_rounded_die_that_looks_sharp_strikes_with_its_radius(sharp: Die, radius_m: float, seed: int) -> None:
    """The contour of a cube rounded by two pixels puts it five millimetres too far away, where it strikes below the table."""
    die = replace(sharp, corner_radius_m=radius_m)
    track, throw = filmed(die, seed, inset_px(die, filmed(die, seed, 0.0)[1]))
    found, sigma_px = radius_by_impacts(track, sharp, CAMERA)
    assert found is not None
    assert sigma_px == OPEN_CONTOUR_PX
    assert abs(found.radius_m - radius_m) < 2.0 * found.sigma_m
    known = replace(track, contour_sigma_px=sigma_px)
    # The corner of a cube strikes later by 0.7 of an error of its radius, and the line of sight is slanting.
    assert distance_error_m(known, replace(sharp, corner_radius_m=found.radius_m), throw) < 2.0 * found.sigma_m


def test_a_contour_that_lies_elsewhere_is_found_without_a_radius() -> None:
    """That of a sharp die, half a pixel within its place."""
    track, throw = filmed(CUBE, 2, 0.5)
    found, sigma_px = radius_by_impacts(track, CUBE, CAMERA)
    assert sigma_px == OPEN_CONTOUR_PX
    assert found is None or found.radius_m < 0.5e-3
    assert distance_error_m(track, CUBE, throw) > 4e-3
    assert distance_error_m(replace(track, contour_sigma_px=sigma_px), CUBE, throw) < 0.1e-3


def test_a_die_tracked_again_meets_the_table_as_before() -> None:
    """At its corners, on all frames; not if it is lost, or strikes in the air."""
    die = replace(CUBE, corner_radius_m=0.5e-3)
    before, again = filmed(die, 2, 0.3)[0], filmed(die, 2, 0.0)[0]
    assert flies_as_before(again, before, die, CAMERA)
    n = len(again)
    lost = replace(again, status=np.where(np.arange(n) < 0.9 * n, again.status, LOST))
    assert not flies_as_before(lost, before, die, CAMERA)
    # Half a circumradius and more above the table no contact is looked for.
    above = replace(again, position_m=again.position_m + np.array([0.0, 0.0, 0.02]))
    assert not flies_as_before(above, before, die, CAMERA)


def test_a_throw_without_a_flight_shows_nothing() -> None:
    track, _ = filmed(CUBE, 1, 0.0)
    assert radius_by_impacts(replace(track, status=np.full(len(track), LOST)), CUBE, CAMERA) == (None, 0.0)
