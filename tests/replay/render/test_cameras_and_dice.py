"""Pictures of ordinary cameras and dice: rolling shutter, depth of field, gloss, recesses, a second die."""

from __future__ import annotations

import numpy as np
import pytest
from film_studio import camera, flight, with_mitsuba

from diethrow.model.die.die import Die, make_die
from diethrow.model.rotations import quat_from_rotvec
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.replay.render.die_surface import TILE_PX, die_mesh, face_paint, mark_heights, stretched
from diethrow.replay.render.lens import PINHOLE, Aperture, optics_of
from diethrow.replay.render.mitsuba_scene import Appearance, lamp_beside
from diethrow.replay.render.renderer import FilmRenderer, RenderSettings, _without_fireflies, frame_light
from diethrow.replay.render.shutter import Shutter, row_times

CUBE = make_die("cube", 0.016, 0.005)
NOW = np.array([0.0])
INSTANT = Shutter(1e-6)


def studio(
    die: Die = CUBE, *, aperture: Aperture = PINHOLE, dice: int = 1, samples: int = 32, **look: float
) -> FilmRenderer:
    view = camera()
    appearance = Appearance(lamp_beside(view), grain=0.0, **look)
    return FilmRenderer(die, view, "matte", appearance, aperture=aperture, dice=dice, rendering=RenderSettings(samples))


@with_mitsuba
def test_a_row_of_a_rolling_shutter_shows_the_die_at_its_instant() -> None:
    room = studio(samples=8)
    moving, readout_s = flight((0.0, 0.0, 0.02), (3.0, 0.0, 0.0)), 4e-3
    rolling = next(frame_light(room, moving, NOW, Shutter(1e-4, readout_s)))
    (frozen,) = frame_light(room, moving, NOW, INSTANT)
    for row in (20, 27, 34):
        (own,) = frame_light(room, moving, row_times(readout_s, 96)[[row]], INSTANT)
        # The die moves 4 to 8 px between the middle row and these, and with it its edges of a tenth of the range or more.
        moved = np.abs(own[row] - frozen[row]) > 0.15
        assert moved.sum() >= 4
        assert np.abs(rolling[row] - own[row])[moved].mean() < 0.3 * np.abs(rolling[row] - frozen[row])[moved].mean()


def test_the_blur_of_a_lens_grows_with_the_distance_from_the_plane_of_focus() -> None:
    view = camera()
    aperture = Aperture(0.03, 0.5)
    axis = view.centre_m + np.array([0.45, 0.48, 0.5, 0.52, 0.56])[:, None] * view.rotation[2]
    discs = np.array([aperture.blur_px(view, point[None]) for point in axis])
    assert discs[2] == pytest.approx(0.0, abs=1e-9)
    assert discs[0] > discs[1] > 1.0
    assert discs[4] > discs[3] > 1.0
    assert discs[4] == pytest.approx(1100.0 * 0.03 * (1 / 0.5 - 1 / 0.56))
    assert aperture.points(view, axis) == int(np.ceil(np.pi / 4 * discs.max() ** 2))


def test_every_point_of_the_aperture_sees_the_plane_of_focus_at_the_same_pixels() -> None:
    view = camera()
    aperture, optics = Aperture(0.03, 0.5), optics_of(view, 0.6)
    for offset in aperture.offsets_m(12):
        seen = aperture.seen_from(optics, offset)
        moved = view.centre_m + offset[0] * view.rotation[0] + offset[1] * view.rotation[1]
        assert seen.pose[:3, 3] == pytest.approx(moved, abs=1e-12)
        for point in view.centre_m + 0.5 * view.rotation[2] + 0.02 * np.eye(3)[:2] @ view.rotation:
            ray = view.rotation @ (point - moved)
            pixel = optics.focal_px * ray[:2] / ray[2] + np.array(seen.middle_px)
            assert pixel == pytest.approx(view.project(point[None])[0], abs=1e-9)


def test_any_run_of_aperture_points_covers_it() -> None:
    offsets = Aperture(2.0, 1.0).offsets_m(96)
    assert np.linalg.norm(offsets, axis=1).max() < 1.1
    for begin in range(0, 84, 12):
        run = offsets[begin : begin + 12]
        # A disc of radius 1 has a mean square of 1/4 per axis; a run of 12 covers it to a half.
        assert np.abs(run.mean(0)).max() < 0.2
        assert (run**2).mean(0) == pytest.approx([0.25, 0.25], abs=0.12)


@with_mitsuba
def test_a_die_out_of_focus_is_blurred_and_stays_in_its_place() -> None:
    throw = flight((0.0, 0.0, 0.02))
    pictures = [
        next(frame_light(studio(aperture=Aperture(diameter, focus), samples=12), throw, NOW, INSTANT))
        for diameter, focus in ((0.0, 1.0), (0.03, 0.5), (0.03, 0.42))
    ]
    sharp, focused, blurred = pictures
    steepest = [np.abs(np.diff(picture[20:76], axis=1)).max(1).mean() for picture in pictures]
    assert steepest[1] > 0.8 * steepest[0]
    assert steepest[2] < 0.6 * steepest[0]
    # Its disc is 12 px wide, and the bright face is cut off where that makes it darker than the threshold.
    assert _centre(blurred) == pytest.approx(_centre(sharp), abs=1.0)
    assert _centre(focused) == pytest.approx(_centre(sharp), abs=0.25)


def _centre(picture: np.ndarray) -> np.ndarray:
    """Centre of the bright pixels, which are the die's."""
    weight = np.clip(picture - 0.45, 0.0, None)
    rows, columns = np.indices(picture.shape)
    return np.array([(weight * rows).sum(), (weight * columns).sum()]) / weight.sum()


@with_mitsuba
def test_a_glossy_die_has_highlights_above_full_scale_that_move_over_it() -> None:
    die = make_die("cube", 0.016, 0.005, corner_radius_m=0.003)
    room = studio(die, roughness=0.05, lamp_side_m=0.2, samples=12)
    spots = []
    for turn in (0.0, 0.5):
        start = State(
            0.0, np.array([0.0, 0.0, 0.02]), quat_from_rotvec(np.array([0.4, 0.3, turn])), np.zeros(3), np.zeros(3)
        )
        (light,) = frame_light(room, Throw((Flight(start, np.inf),), ()), NOW, INSTANT)
        assert light.max() > 1.0
        spots.append(np.argwhere(light > 1.0).mean(0))
    assert np.linalg.norm(spots[0] - spots[1]) > 1.0


@with_mitsuba
def test_a_second_die_is_seen_where_the_camera_projects_it() -> None:
    room = studio(dice=2, samples=8)
    throws = flight((-0.012, 0.0, 0.02)), flight((0.012, 0.01, 0.01))
    change = np.abs(next(frame_light(room, throws, NOW, INSTANT)) - room.empty())
    for throw in throws:
        x, y = room.camera.project(throw.at(0.0).position_m[None])[0].round().astype(int)
        assert change[y - 5 : y + 6, x - 5 : x + 6].mean() > 0.1


def test_single_bright_pixels_are_removed_from_the_table_and_its_own_specks_and_the_die_are_kept() -> None:
    empty = np.full((40, 40), 0.2)
    empty[10, 10] = 0.6  # a speck of granite
    light = 0.5 * empty  # all in the shade
    light[30, 30] = light[5, 30] = 0.9
    kept = np.zeros((40, 40), bool)
    kept[:10, 25:] = True
    clean = _without_fireflies(light, empty, kept)
    assert clean[30, 30] == pytest.approx(0.1, rel=1e-5)
    assert clean[5, 30] == 0.9
    light[30, 30] = clean[30, 30]
    assert clean == pytest.approx(light, rel=1e-5)


def test_speckles_cover_their_share_of_the_faces() -> None:
    paint = face_paint(CUBE, die_reflectance=0.8, mark_reflectance=0.0, grain=0.0, seed=1, speckle=0.25)
    assert (paint < 0.5).mean() == pytest.approx(0.25, abs=0.01)


def test_recesses_are_deepest_in_the_middle_of_a_pip_and_flat_between() -> None:
    die = make_die("cube", 0.016, 0.005, marks="pips")
    heights = mark_heights(die, 0.0005)
    first = heights[:TILE_PX, :TILE_PX]
    assert heights.min() == pytest.approx(-0.0005, rel=1e-6)
    assert first[0].max() == first[0].min() == 0.0
    assert np.linalg.norm(np.argwhere(first < -0.00049).mean(0) - (TILE_PX - 1) / 2) < 1.5


def test_a_stretched_die_has_unequal_edges_and_normals_at_right_angles_to_its_faces() -> None:
    mesh = stretched(die_mesh(make_die("octahedron", 0.016, 0.005)), (1.05, 1.0, 0.95))
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1)[:, None]
    assert across == pytest.approx(mesh.normals[mesh.triangles[:, 0]], abs=1e-12)
    assert np.ptp(mesh.vertices_m, axis=0)[0] / np.ptp(mesh.vertices_m, axis=0)[2] == pytest.approx(1.05 / 0.95)
