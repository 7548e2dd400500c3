"""The parts of a film: the die's surface, its paint, the sensor; and, with Mitsuba installed, the images."""

from __future__ import annotations

import numpy as np
import pytest
from film_studio import camera, flight, with_mitsuba
from numpy.typing import NDArray

from diethrow.model.die.die import Die, make_die
from diethrow.model.die.solid import SHAPES, Solid, convex_solid, inner_vertices
from diethrow.model.rotations import quat_from_matrix, rotation_between
from diethrow.replay.render.die_surface import PIPS, TILE_PX, die_mesh, face_frame, face_paint
from diethrow.replay.render.image_boxes import blend, rounded_up
from diethrow.replay.render.lens import optics_of, undistorted
from diethrow.replay.render.mitsuba_scene import Appearance, lamp_beside
from diethrow.replay.render.renderer import FilmRenderer, RenderSettings, frame_light
from diethrow.replay.render.sensor import Sensor, expose, fixed_pattern, rounded
from diethrow.replay.render.table_textures import SURFACES, table_paint
from diethrow.tracking.picture import PixelNoise
from diethrow.tracking.picture.view import make_view
from diethrow.tracking.pose.refine import pose_state, refine_pose

Array = NDArray[np.float64]

RADII = (0.0, 0.0008)


def edge_of(shape: str) -> float:
    """The edge of each die with a circumradius of 11 mm."""
    return 0.011 / make_die(shape, 1.0, 1.0).solid.circumradius


# --- the surface ---


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("radius", RADII)
def test_the_surface_is_closed(shape: str, radius: float) -> None:
    """Every edge of a triangle is the edge of exactly one other in the opposite direction: no hole, none inside out."""
    mesh = die_mesh(make_die(shape, edge_of(shape), 0.005, corner_radius_m=radius))
    # Corners of neighbouring parts coincide to rounding: one name for each place, to a nanometre.
    _, name = np.unique(np.rint(mesh.vertices_m * 1e9).astype(int), axis=0, return_inverse=True)
    triangles = name.ravel()[mesh.triangles]
    runs = [(int(t[j]), int(t[(j + 1) % 3])) for t in triangles for j in range(3)]
    assert len(set(runs)) == len(runs)
    assert all((b, a) in set(runs) for a, b in runs[::7])
    assert {(b, a) for a, b in runs} == set(runs)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("radius", RADII)
def test_the_volume_is_steiners(shape: str, radius: float) -> None:
    """V(K + rB) = V + r A + r²/2 Σ length × exterior angle + 4/3 π r³ (Steiner 1840)."""
    die = make_die(shape, edge_of(shape), 0.005, corner_radius_m=radius)
    mesh, inner = die_mesh(die), inner_vertices(die.solid, radius)
    a, b, c = (mesh.vertices_m[mesh.triangles[:, j]] for j in range(3))
    volume = float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6.0
    solid = convex_solid(inner)
    turns = np.arccos(np.einsum("ei,ei->e", *(solid.normals[solid.edge_faces[:, k]] for k in (0, 1))))
    lengths = np.linalg.norm(np.subtract(*inner[die.solid.edges.T]), axis=1)
    steiner = _volume(solid) + radius * _area(solid) + radius**2 / 2 * lengths.mean() * turns.sum()
    # Chords of up to 14° miss 1 % of the round parts, which are up to a tenth of the whole.
    assert volume == pytest.approx(steiner + 4.0 / 3.0 * np.pi * radius**3, rel=1e-12 if radius == 0 else 2e-3)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


def _area(solid: Solid) -> float:
    return sum(_face_area(solid, k) for k in range(len(solid.faces)))


def _volume(solid: Solid) -> float:
    return sum(_face_area(solid, k) * solid.offsets[k] for k in range(len(solid.faces))) / 3.0


def _face_area(solid: Solid, face: int) -> float:
    corners = solid.vertices[list(solid.faces[face])]
    spokes = corners[1:] - corners[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]), axis=1).sum() / 2.0)


@pytest.mark.parametrize("shape", SHAPES)
def test_marks_are_drawn_as_seen_from_outside(shape: str) -> None:
    die = make_die(shape, edge_of(shape), 0.005)
    for face in range(len(die.solid.faces)):
        frame = face_frame(die.solid, face)
        assert np.cross(frame.right, frame.up) == pytest.approx(die.solid.normals[face], abs=1e-12)


def test_each_face_of_a_cube_has_its_pips() -> None:
    die = make_die("cube", 0.016, 0.005, marks="pips")
    atlas = face_paint(die, die_reflectance=0.8, mark_reflectance=0.0, grain=0.0, seed=1)
    frame = face_frame(die.solid, 0)
    disc = np.pi * (0.09 * 0.016 / frame.half_m * TILE_PX / 2) ** 2
    for face in range(6):
        row, column = divmod(face, 3)
        tile = atlas[row * TILE_PX : (row + 1) * TILE_PX, column * TILE_PX : (column + 1) * TILE_PX]
        # OpenCV fills the pixels that an outline touches: up to 0.5 px more radius, on 50 px.
        assert (1.0 - tile / 0.8).sum() == pytest.approx(len(PIPS[face + 1]) * disc, rel=0.025)


def test_numbers_stay_on_their_face() -> None:
    die = make_die("icosahedron", 0.0105, 0.003, marks="numbers")
    atlas = face_paint(die, die_reflectance=0.8, mark_reflectance=0.0, grain=0.0, seed=1)
    frame = face_frame(die.solid, 0)
    inked = np.argwhere(atlas[:TILE_PX, :TILE_PX] < 0.7)
    away = np.linalg.norm(inked - (TILE_PX - 1) / 2, axis=1).max() * 2 * frame.half_m / TILE_PX
    assert 0.2 * frame.inscribed_m < away < frame.inscribed_m


@pytest.mark.parametrize("surface", SURFACES)
def test_a_table_reflects_less_than_all_light_and_has_a_texture(surface: str) -> None:
    paint = table_paint(f"old {surface}", 3)
    assert paint.min() >= 0.0
    assert paint.max() < 1.0
    assert paint.std() > 0.0005


# --- the sensor ---


def test_noise_grows_with_the_light_as_the_emva_standard_states() -> None:
    sensor = Sensor(12)
    pattern = fixed_pattern(sensor, 1, 20_000)
    rng = np.random.default_rng(1)
    for light in (0.0, 0.1, 0.8):
        shots = np.array([expose(sensor, pattern, np.full((1, 20_000), light), rng) for _ in range(20)])
        scale = sensor.top / sensor.full_well_e
        expected = scale**2 * (light * sensor.full_well_e + sensor.read_noise_e**2)
        # 400 000 draws give a variance to 0.3 %.
        assert shots.var(0, ddof=1).mean() == pytest.approx(expected, rel=0.01)


def test_a_sensor_keeps_its_pattern_and_its_range() -> None:
    sensor = Sensor(8, read_noise_e=0.0)
    pattern = fixed_pattern(sensor, 20, 30)
    assert (pattern.gain == fixed_pattern(sensor, 20, 30).gain).all()
    bright = rounded(sensor, expose(sensor, pattern, np.full((20, 30), 3.0), np.random.default_rng(1)))
    assert bright.dtype == np.uint8
    assert (bright == 255).all()
    with pytest.raises(ValueError, match=r"bit_depth = 7: wanted 8 to 16 bits"):
        Sensor(7)


# --- the lens ---


def test_undistorted_directions_project_back_onto_their_pixels() -> None:
    view = camera(distortion=-0.5)
    directions = undistorted(view)
    there = np.concatenate([directions, np.ones((*directions.shape[:2], 1))], -1)
    world = (there - view.translation_m) @ view.rotation
    px = view.project(world)
    expected = (np.arange(2 * view.width_px) + 0.5) / 2 - 0.5
    assert np.abs(px[..., 0] - expected).max() < 1e-5
    assert np.abs(px[..., 1] - expected[:, None]).max() < 1e-5


def test_a_distortion_that_is_not_invertible_is_refused() -> None:
    with pytest.raises(ValueError, match=r"distortion = .*not invertible"):
        undistorted(camera(distortion=-400.0))


def test_a_distorted_image_keeps_its_light() -> None:
    """Computed from the ideal image, a uniform image is uniform, and a spot keeps its light up to the lens's magnification."""
    optics = optics_of(camera(distortion=1e-9), 0.7)
    box = (10, 20, 60, 70)
    fine = optics.rendered_box(box)
    ideal = np.ones((fine[3] - fine[1], fine[2] - fine[0]))
    assert optics.to_real_image(ideal, box, fine) == pytest.approx(1.0, abs=1e-9)
    ideal[50, 50] += 4.0
    assert optics.to_real_image(ideal, box, fine).sum() == pytest.approx(50 * 50 + 1.0, abs=2e-3)


@pytest.mark.parametrize("box", [(0, 0, 5, 9), (90, 91, 96, 96), (3, 40, 90, 50), (0, 0, 96, 96), (31, 32, 63, 64)])
def test_an_enlarged_box_contains_the_box_and_stays_in_the_image(box: tuple[int, int, int, int]) -> None:
    left, top, right, bottom = rounded_up(box, camera(), 32)
    assert 0 <= left <= box[0] < box[2] <= right <= 96
    assert 0 <= top <= box[1] < box[3] <= bottom <= 96
    assert (right - left) % 32 == (bottom - top) % 32 == 0


def test_blending_an_image_into_itself_changes_nothing_and_into_another_leaves_no_seam() -> None:
    picture = np.random.default_rng(1).uniform(size=(60, 70))
    same = picture.copy()
    blend(same, picture[5:50, 0:40].copy(), (0, 5, 40, 50))
    assert same == pytest.approx(picture, abs=1e-15)
    flat = np.zeros((60, 70))
    blend(flat, np.ones((45, 40)), (0, 5, 40, 50))
    assert flat[27, :30].min() == 1.0  # a border of the picture itself is no seam
    assert np.abs(np.diff(flat, axis=1)).max() < 0.13  # one step of eight


# --- pictures ---


def studio(
    die: Die, *, surface: str = "matte", distortion: float = 0.0, samples: int = 16, size: int = 96
) -> FilmRenderer:
    view = camera(distortion, size)
    appearance = Appearance(lamp_beside(view), lamp_side_m=0.02, grain=0.0)
    return FilmRenderer(die, view, surface, appearance, rendering=RenderSettings(samples))


@with_mitsuba
@pytest.mark.parametrize("distortion", [0.0, -8.0])
def test_the_die_is_seen_where_the_camera_projects_it(distortion: float) -> None:
    """The tracker is independent of the renderer, and finds the die on one frame at its true pose."""
    die = make_die("cube", 0.016, 0.005)
    room = studio(die, distortion=distortion, samples=64, size=160)
    throw = flight((0.0, 0.0, 0.03))
    light = next(frame_light(room, throw, np.array([0.0]), 1e-6))
    view = make_view(room.camera, die, np.asarray(255.0 * room.empty(), np.float32), PixelNoise(1.5), None, 0.6)
    true = throw.at(0.0)
    found = refine_pose(view, np.asarray(255.0 * light, np.float32), pose_state(true.position_m, true.rotation))
    assert found is not None
    miss = room.camera.rotation @ (found.position_m - true.position_m)
    # 0.45 mm a pixel: within a tenth of a pixel, where a pixel's half would betray another origin of the axes. The
    # distortion moves the corners by a pixel; depth follows from a size of 50 px.
    assert np.abs(miss[:2]).max() < 0.05e-3
    assert abs(miss[2]) < 1e-3
    turned = np.linalg.norm(rotation_between(quat_from_matrix(found.rotation), true.quaternion))
    assert np.degrees(turned) < 0.7


@with_mitsuba
def test_a_resting_die_has_no_motion_blur_and_a_moving_one_the_mean_of_its_instants() -> None:
    die = make_die("cube", 0.016, 0.005, marks="pips")
    room = studio(die, samples=32)
    moving = flight((0.0, 0.0, 0.03), (2.0, 0.0, 0.0))
    times = np.array([0.0])
    blurred = next(frame_light(room, moving, times, 1e-3))
    instants = [next(frame_light(room, flight((0.002 * s, 0.0, 0.03)), times, 1e-6)) for s in np.linspace(-0.5, 0.5, 9)]
    # The path tracer's noise at 32 samples is 3 % of the range; a die displaced by a pixel changes its edges by 30 %.
    assert np.abs(blurred - np.mean(instants, 0)).mean() < 0.015
    assert np.abs(blurred - instants[4]).max() > 0.15


@with_mitsuba
def test_a_mirror_shows_the_die_upside_down() -> None:
    """The light changes where the mirror image of the die is projected, and nowhere else."""
    die = make_die("cube", 0.012, 0.005)
    room = studio(die, surface="mirror", samples=16)
    throw = flight((0.0, 0.0, 0.012))
    change = np.abs(next(frame_light(room, throw, np.array([0.0]), 1e-6)) - room.empty())
    image = room.camera.project(np.array([0.0, 0.0, -0.012])).round().astype(int)
    at_image, aside = (change[y - 4 : y + 5, x - 4 : x + 5].mean() for x, y in (image, image + np.array([25, 0])))
    # The image's shaded faces are a few grey levels of the room's, the path tracer's noise is a hundredth of the range.
    assert at_image > 0.04
    assert at_image > 3.0 * aside


@with_mitsuba
def test_a_die_outside_the_image_leaves_the_table_empty() -> None:
    room = studio(make_die("cube", 0.016, 0.005), samples=4)
    light = next(frame_light(room, flight((3.0, 0.0, 0.02)), np.array([0.0]), 1e-6))
    assert (light == room.empty()).all()


def test_a_blur_below_that_of_a_pixel_is_refused() -> None:
    with pytest.raises(ValueError, match=r"blur_px = 0.2: wanted 0.4 or more"):
        FilmRenderer(make_die("cube", 0.016, 0.005), camera(), "wood", Appearance(lamp_beside(camera())), blur_px=0.2)
