"""Every mistake in a scene is one sentence that names the file, the key, the value and what is accepted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import CUBE_ON_WOOD, invoke, text_file

from diethrow.files.scene import SceneError, read_scene
from diethrow.tracking.clip_parameters.corner_radius import CornerRounding

SCENE = f"""\
[clip]
path = "clip.avi"
fps = 1500.0
exposure_s = 0.0002
background = "background.png"

[camera]
width = 384
height = 384
matrix = [[2700.0, 0.0, 197.0], [0.0, 2700.0, 189.0], [0.0, 0.0, 1.0]]
rotation = [[1.0, 0.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.8, -0.6]]
translation_m = [0.0, 0.02, 0.6]
{CUBE_ON_WOOD}marks = "pips"
"""

# What is replaced, by what, and what the sentence must say.
MISTAKES = {
    "missing key": ("edge_m = 0.016\n", "", ["die.edge_m", "missing", "metres"]),
    "missing table": ('[table]\nsurface = "wood"\n', "", ["table is missing", "surface"]),
    "unknown key": ("fps = 1500.0", "fps = 1500.0\nexpsure_s = 1e-4", ["clip.expsure_s", "0.0001", "exposure_s?"]),
    "unit in another name": ("edge_m = 0.016", "edge_mm = 16", ["die.edge_mm", "16", "did you mean edge_m?"]),
    "key of another table": ("edge_m =", "fps = 1500.0\nedge_m =", ["die.fps", "belongs in [clip]"]),
    "unknown table": ("[table]", '[film]\na = "b"\n[table]', ["film", "there is no such key"]),
    "millimetres": ("edge_m = 0.016", "edge_m = 16", ["die.edge_m = 16", "metres", "did you mean 0.016?"]),
    "grams": ("mass_kg = 0.0048", "mass_kg = 4.8", ["die.mass_kg = 4.8", "kilograms", "did you mean 0.0048?"]),
    "milliseconds": ("0.0002", "0.2", ["clip.exposure_s = 0.2", "seconds", "did you mean 0.0002?"]),
    "readout in milliseconds": (
        "fps = 1500.0",
        "fps = 1500.0\nreadout_s = 0.5",
        ["clip.readout_s = 0.5", "seconds", "0.0006667", "did you mean 0.0005?"],
    ),
    "readout below zero": (
        "fps = 1500.0",
        "fps = 1500.0\nreadout_s = -1e-4",
        ["clip.readout_s", "-0.0001", "0 or more"],
    ),
    "readout of text": ("fps = 1500.0", 'fps = 1500.0\nreadout_s = "slow"', ["clip.readout_s", '"slow"', "0 or more"]),
    "calibration that is not there": (
        "[0.0, 0.02, 0.6]",
        '[0.0, 0.02, 0.6]\ncalibration = "c.json"',
        ["camera.calibration", "c.json", "does not exist", "diethrow calibrate"],
    ),
    "calibration of a number": (
        "[0.0, 0.02, 0.6]",
        "[0.0, 0.02, 0.6]\ncalibration = 0.001",
        ["camera.calibration", "0.001", '"exact"'],
    ),
    "calibration that is no record": (
        "[0.0, 0.02, 0.6]",
        '[0.0, 0.02, 0.6]\ncalibration = "clip.avi"',
        ["camera.calibration", "clip.avi", "no record of a calibration", '"exact"'],
    ),
    "edge known to millimetres": (
        "edge_m = 0.016",
        "edge_m = 0.016\nedge_sigma_m = 0.01",
        ["die.edge_sigma_m = 0.01", "metres", "tenth of edge_m"],
    ),
    "edge known to less than nothing": (
        "edge_m = 0.016",
        "edge_m = 0.016\nedge_sigma_m = -1e-5",
        ["die.edge_sigma_m", "0 or more"],
    ),
    "rate hardly known": (
        "fps = 1500.0",
        "fps = 1500.0\nfps_sigma = 1500.0",
        ["clip.fps_sigma = 1500", "tenth of fps"],
    ),
    "rate known to a word": ("fps = 1500.0", 'fps = 1500.0\nfps_sigma = "well"', ["clip.fps_sigma", "0 or more"]),
    "camera in millimetres": ("[0.0, 0.02, 0.6]", "[0, 20, 600]", ["translation_m", "metres", "[0, 0.02, 0.6]?"]),
    "gravity in centimetres": (
        "[table]",
        "[world]\ngravity_m_s2 = 981.0\n[table]",
        ["world.gravity_m_s2 = 981", "9.78"],
    ),
    "gravity upwards": (
        "[table]",
        "[world]\ngravity_m_s2 = -9.81\n[table]",
        ["world.gravity_m_s2 = -9.81", "0.1 to 30"],
    ),
    "gravity of text": ("[table]", '[world]\ngravity_m_s2 = "moon"\n[table]', ["world.gravity_m_s2", '"moon"']),
    "text for a number": ("fps = 1500.0", 'fps = "1500"', ["clip.fps", '"1500"', "frames per second"]),
    "truth value for a number": ("fps = 1500.0", "fps = true", ["clip.fps", "true", "frames per second"]),
    "fps of zero": ("fps = 1500.0", "fps = 0", ["clip.fps = 0", "above 0"]),
    "fps below zero": ("fps = 1500.0", "fps = -1500.0", ["clip.fps = -1500", "above 0"]),
    "fps not finite": ("fps = 1500.0", "fps = inf", ["clip.fps", "above 0"]),
    "exclude that falls": ("fps = 1500.0", "fps = 1500.0\nexclude = [[9, 3]]", ["clip.exclude", "[first, stop]"]),
    "exclude of text": ("fps = 1500.0", 'fps = 1500.0\nexclude = ["9"]', ["clip.exclude", "frame numbers"]),
    "response without a meaning": (
        "fps = 1500.0",
        'fps = 1500.0\nresponse = "gamma"',
        ["clip.response", '"gamma"', '"linear", "srgb"', "light ** exponent"],
    ),
    "response the wrong way round": (
        "fps = 1500.0",
        "fps = 1500.0\nresponse = 2.2",
        ["clip.response = 2.2", "0.2 to 1.5"],
    ),
    "response of zero": ("fps = 1500.0", "fps = 1500.0\nresponse = 0", ["clip.response = 0", "0.2 to 1.5"]),
    "response that is true": ("fps = 1500.0", "fps = 1500.0\nresponse = true", ["clip.response", "true"]),
    "start without a frame": ("[table]", "[start]\nposition_m = [0, 0, 0.1]\n[table]", ["start.frame is missing"]),
    "start with half a pose": (
        "[table]",
        "[start]\nframe = 3\nposition_m = [0, 0, 0.1]\n[table]",
        ["start", "position_m and quaternion_wxyz"],
    ),
    "start below the table": (
        "[table]",
        "[start]\nframe = 3\nposition_m = [0, 0, -0.1]\nquaternion_wxyz = [1, 0, 0, 0]\n[table]",
        ["start.position_m", "above the table"],
    ),
    "start that is no rotation": (
        "[table]",
        "[start]\nframe = 3\nposition_m = [0, 0, 0.1]\nquaternion_wxyz = [1, 1, 0, 0]\n[table]",
        ["start.quaternion_wxyz", "length 1"],
    ),
    "three clicks": (
        "[table]",
        "[start]\nframe = 3\ncorners = [{px = [1, 2]}, {px = [3, 4]}, {px = [5, 6]}]\n[table]",
        ["start.corners", "3 clicks", "4 or more"],
    ),
    "a vertex twice": (
        "[table]",
        "[start]\nframe = 3\ncorners = [{px = [1, 2], vertex = 1}, {px = [3, 4], vertex = 1}, {px = [5, 6], vertex = 2}, "
        "{px = [7, 8], vertex = 3}]\n[table]",
        ["start.corners.vertex", "different numbers from 0 to 7"],
    ),
    "a click outside": (
        "[table]",
        "[start]\nframe = 3\ncorners = [{px = [1, 2]}, {px = [3, 4]}, {px = [5, 6]}, {px = [700, 6]}]\n[table]",
        ["start.corners.px", "inside the picture"],
    ),
    "start on an excluded frame": (
        'background = "background.png"',
        "exclude = [[2, 5]]\n[start]\nframe = 3\nposition_m = [0, 0, 0.1]\nquaternion_wxyz = [1, 0, 0, 0]",
        ["start.frame = 3", "clip.exclude"],
    ),
    "fraction of a pixel": ("width = 384", "width = 384.5", ["camera.width = 384.5", "whole number"]),
    "frames that fall": ("fps = 1500.0", "fps = 1500.0\nframes = [9, 3]", ["clip.frames = [9, 3]", "first < stop"]),
    "matrix of two rows": ("[0.0, 2700.0, 189.0], ", "", ["camera.matrix", "3 rows of 3"]),
    "matrix upside down": ("[0.0, 0.0, 1.0]]\nrot", "[0.0, 1.0, 0.0]]\nrot", ["camera.matrix", "fx, s, cx"]),
    "text in a matrix": ("[2700.0, 0.0, 197.0]", '[2700.0, "0", 197.0]', ["camera.matrix", "3 rows of 3"]),
    "distortion of four": ("rotation", "distortion = [0, 0, 0, 0]\nrotation", ["camera.distortion", "5 numbers"]),
    "no rotation": ("[0.0, -0.6, -0.8]", "[0.0, -0.6, -0.9]", ["camera.rotation", "-0.9", "right angles"]),
    "reflection": ("[[1.0, 0.0, 0.0]", "[[-1.0, 0.0, 0.0]", ["camera.rotation", "reflection"]),
    "camera below the table": ("[0.0, 0.02, 0.6]", "[0.0, -0.9, 0.6]", ["camera.translation_m", "below the table"]),
    "camera that looks up": (
        "[[1.0, 0.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.8, -0.6]]\ntranslation_m = [0.0, 0.02, 0.6]",
        "[[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.0, 0.8, 0.6]]\ntranslation_m = [0.0, 0.02, -0.6]",
        ["camera.rotation", "the table"],
    ),
    "footage that is not there": ("clip.avi", "klip.avi", ["clip.path", "klip.avi", "does not exist"]),
    "background that is not there": ('"background.png"', '"b.png"', ["clip.background", "b.png", "does not exist"]),
    "absolute path": ('"clip.avi"', '"/etc/hostname"', ["clip.path", "/etc/hostname", "--allow-outside"]),
    "path that leaves": ('"clip.avi"', '"../clip.avi"', ["clip.path", "../clip.avi", "folder"]),
    "path that leaves by a bend": ('"background.png"', '"x/../../b.png"', ["clip.background", "--allow-outside"]),
    "pattern that leaves": ('"clip.avi"', '"../*/frame_*.png"', ["clip.path", "--allow-outside"]),
    "path too long": ('"clip.avi"', '"' + "a" * 300 + '"', ["clip.path", "too long"]),
    "number too long": ("fps = 1500.0", "fps = " + "9" * 5000, ["not valid TOML"]),
    "tables too deep": ("fps = 1500.0", "fps = " + "[" * 9000, ["not valid TOML"]),
    "empty path": ('"clip.avi"', '""', ["clip.path", '""', "path of the footage"]),
    "unknown shape": ('"cube"', '"qube"', ["die.shape", "qube", "tetrahedron, cube, octahedron"]),
    "pips on a tetrahedron": ('shape = "cube"', 'shape = "tetrahedron"', ["die.marks", "pips", "tetrahedron"]),
    "length of another shape": (
        "edge_m =",
        "unit_m = 0.001\nedge_m =",
        ["die.unit_m = 0.001", "not of a cube", "edge_m"],
    ),
    "a d10 without its shorter edge": (
        'shape = "cube"',
        'shape = "d10"',
        ["die.short_edge_m is missing", "between neighbouring corners", "metres"],
    ),
    "a cuboid in millimetres": (
        'shape = "cube"\nedge_m = 0.016',
        'shape = "cuboid"\nedges_m = [13.0, 16.0, 19.0]',
        ["die.edges_m = [13.0, 16.0, 19.0]", "16 in the mean", "did you mean 0.016?"],
    ),
    "a cuboid without a length": (
        'shape = "cube"\nedge_m = 0.016',
        'shape = "cuboid"\nedges_m = [0.013, 0.016]',
        ["edges_m = [0.013, 0.016]", "3 lengths"],
    ),
    "a mesh that is not there": (
        'shape = "cube"\nedge_m = 0.016',
        'shape = "die.stl"\nunit_m = 0.001',
        ["die.shape", "die.stl", "does not exist"],
    ),
    "a mesh without its unit": (
        'shape = "cube"\nedge_m = 0.016',
        'shape = "die.stl"',
        ["die.unit_m is missing", "0.001"],
    ),
    "one moment of a body with three": (
        'shape = "cube"\nedge_m = 0.016',
        'shape = "cuboid"\nedges_m = [0.013, 0.016, 0.019]\ninertia_kg_m2 = 2e-7',
        ["die.inertia_kg_m2 = 2e-07", "several moments"],
    ),
    "unknown marks": ('"pips"', '"dots"', ["die.marks", "dots", "numbers"]),
    "corner beyond the die": ("edge_m =", "corner_radius_m = 0.6\nedge_m =", ["corner_radius_m = 0.6", "0.0006?"]),
    "corners below zero": (
        "edge_m =",
        "corner_radius_m = -1e-3\nedge_m =",
        ["die.corner_radius_m = -0.001", "0 or more"],
    ),
    "corners by another word": (
        "edge_m =",
        'corner_radius_m = "soft"\nedge_m =',
        ["corner_radius_m", "soft", "estimate"],
    ),
    "corners that are true": ("edge_m =", "corner_radius_m = true\nedge_m =", ["corner_radius_m = true", "estimate"]),
    "corners in a list": ("edge_m =", "corner_radius_m = [1]\nedge_m =", ["corner_radius_m = [1]", "estimate"]),
    "mass outside the die": ("edge_m =", "inertia_kg_m2 = 2e-3\nedge_m =", ["inertia_kg_m2 = 0.002", "at the corners"]),
    "value for a table": ('[table]\nsurface = "wood"', "", ["table is missing"]),
    "table that swings without a rate": (
        'surface = "wood"',
        'surface = "wood"\nmotion = {amplitude_m = 0.001}',
        ["table.motion.frequency_hz", "missing", "hertz"],
    ),
    "not TOML": ("fps = 1500.0", "fps = = 1500.0", ["not valid TOML", "line 3"]),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the files that the scene names; none of them is opened here."""
    (tmp_path / "clip.avi").write_bytes(b"")
    (tmp_path / "background.png").write_bytes(b"")
    return tmp_path


def scene_file(folder: Path, text: str = SCENE) -> Path:
    return text_file(folder / "scene.toml", text)


@pytest.mark.parametrize(
    ("line", "radius_m", "rounding"),
    [
        ("", 0.0, CornerRounding.TESTED),
        ("corner_radius_m = 0", 0.0, CornerRounding.GIVEN),
        ("corner_radius_m = 0.0005", 0.0005, CornerRounding.GIVEN),
        ('corner_radius_m = "estimate"', 0.0, CornerRounding.ESTIMATED),
    ],
)
def test_a_corner_radius_is_given_or_estimated(
    folder: Path, line: str, radius_m: float, rounding: CornerRounding
) -> None:
    scene = read_scene(scene_file(folder, SCENE + line + "\n"))
    assert scene.die.corner_radius_m == radius_m
    assert scene.rounding is rounding
    if rounding is CornerRounding.ESTIMATED:
        with pytest.raises(SceneError, match=r"die\.corner_radius_m"):
            scene.given_die()
    else:
        assert scene.given_die() is scene.die


def test_a_mesh_beside_the_scene_is_a_die(folder: Path) -> None:
    trimesh.creation.box((20.0, 16.0, 12.0)).export(folder / "die.stl")
    text = SCENE.replace('shape = "cube"\nedge_m = 0.016', 'shape = "die.stl"\nunit_m = 0.001').replace(
        '"pips"', '"numbers"'
    )
    scene = read_scene(scene_file(folder, text))
    assert scene.settings_paths == (scene.path, folder / "die.stl")
    assert len(scene.die.solid.faces) == 6
    assert scene.die.solid.edge_m == pytest.approx(0.016, rel=1e-6)
    # m/12 (b² + c²) of 4.8 g.
    np.testing.assert_allclose(
        np.linalg.eigvalsh(scene.die.tensor_kg_m2), np.array([1.6, 2.176, 2.624]) * 1e-7, rtol=1e-6
    )


def test_a_die_that_no_one_radius_rounds_is_sharp_unless_its_radius_is_asked_for(folder: Path) -> None:
    """Four unlike faces that meet in one corner do not when all are moved inwards alike."""
    corners = [[-0.01, -0.01, 0.0], [0.01, -0.01, 0.0], [0.01, 0.01, 0.0], [-0.01, 0.01, 0.0], [0.004, 0.001, 0.015]]
    text = SCENE.replace('shape = "cube"\nedge_m = 0.016', f'shape = "polyhedron"\ncorners_m = {corners}')
    text = text.replace('"pips"', '"numbers"')
    assert read_scene(scene_file(folder, text)).rounding is CornerRounding.GIVEN
    with pytest.raises(SceneError, match="would no longer meet in one point"):
        read_scene(scene_file(folder, text + 'corner_radius_m = "estimate"\n'))


@pytest.mark.parametrize("mistake", MISTAKES)
def test_every_mistake_is_one_sentence_that_names_file_key_and_value(folder: Path, mistake: str) -> None:
    old, new, facts = MISTAKES[mistake]
    assert SCENE.count(old) >= 1
    path = scene_file(folder, SCENE.replace(old, new))
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence
    for words in facts:
        assert words in sentence


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("command", ["analyze", "track"])
def test_a_wrong_scene_ends_with_status_2_and_no_folder(folder: Path, mistake: str, command: str) -> None:
    old, new, _ = MISTAKES[mistake]
    path = scene_file(folder, SCENE.replace(old, new))
    before = sorted(folder.rglob("*"))
    status, _, message = invoke(command, path, "--out", folder / "out")
    assert status == 2
    assert message.startswith(f"diethrow: {path}: ")
    assert len(message.splitlines()) == 1
    assert sorted(folder.rglob("*")) == before


def test_a_file_that_is_no_text_is_refused(folder: Path) -> None:
    path = folder / "scene.toml"
    path.write_bytes(b'[clip]\npath = "\xff\xfe"\n')
    with pytest.raises(SceneError, match=r"scene\.toml: byte \d+ is not UTF-8"):
        read_scene(path)
    with pytest.raises(SceneError, match="no such file"):
        read_scene(folder / "other.toml")
    with pytest.raises(SceneError, match="folder"):
        read_scene(folder)


def test_a_scene_becomes_the_values_of_the_stages(folder: Path) -> None:
    scene = read_scene(scene_file(folder))
    view = scene.views()[0]
    assert (scene.clip.fps, scene.clip.exposure_s, scene.clip.frame_range) == (1500.0, 0.0002, None)
    assert view.path == folder / "clip.avi"
    assert view.background_path == folder / "background.png"
    assert (view.camera.width_px, view.camera.height_px) == (384, 384)
    assert view.camera.distortion.tolist() == [0.0] * 5
    # By hand: -Rᵀ t = -(0, -0.6·0.02 + 0.8·0.6, -0.8·0.02 - 0.6·0.6).
    np.testing.assert_allclose(view.camera.centre_m, [0.0, -0.468, 0.376], atol=1e-15)
    assert (scene.die.solid.name, scene.die.mass_kg, scene.die.marks) == ("cube", 0.0048, "pips")
    # A homogeneous cube: m a² / 6.
    assert scene.die.inertia_kg_m2 == pytest.approx(0.0048 * 0.016**2 / 6, rel=1e-12)
    assert scene.table.surface == "wood"


def test_a_title_names_the_throw_or_else_the_folder(folder: Path) -> None:
    assert read_scene(scene_file(folder)).name == folder.name
    assert read_scene(scene_file(folder, f'title = "Ahorn, 3. Wurf"\n{SCENE}')).name == "Ahorn, 3. Wurf"
    with pytest.raises(SceneError, match='title = " ": wanted the title of the throw'):
        read_scene(scene_file(folder, f'title = " "\n{SCENE}'))


def test_a_byte_order_mark_changes_nothing(folder: Path) -> None:
    assert read_scene(scene_file(folder, "\ufeff" + SCENE)).clip.fps == 1500.0


def test_a_rotation_with_four_decimals_becomes_the_nearest_rotation(folder: Path) -> None:
    angle = 0.9
    c, s = round(float(np.cos(angle)), 4), round(float(np.sin(angle)), 4)
    text = SCENE.replace("[0.0, -0.6, -0.8], [0.0, 0.8, -0.6]", f"[0.0, {-c}, {-s}], [0.0, {s}, {-c}]")
    rotation = read_scene(scene_file(folder, text)).views()[0].camera.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    # No entry moves by more than its rounding.
    np.testing.assert_allclose(rotation[1:, 1:], [[-c, -s], [s, -c]], atol=1e-4)


def test_a_scene_without_footage_is_enough_for_a_fit_and_refused_for_tracking(folder: Path) -> None:
    text = '[clip]\nfps = 148.0\n[table]\nsurface = "acrylic"\n[die]\nshape = "cube"\nedge_m = 0.1048\nmass_kg = 0.37\n'
    scene = read_scene(scene_file(folder, text))
    assert scene.cameras == ()
    with pytest.raises(SceneError, match="camera is missing"):
        scene.views()


def test_two_cameras_are_read_and_an_error_names_which(folder: Path) -> None:
    head, camera, tail = SCENE.partition("[camera]")[0], SCENE[SCENE.index("[camera]") : SCENE.index("[table]")], ""
    tail = SCENE[SCENE.index("[table]") :]
    second = camera.replace("[camera]", '[[camera]]\npath = "clip.avi"')
    text = head + camera.replace("[camera]", "[[camera]]") + second + tail
    scene = read_scene(scene_file(folder, text))
    assert [view.path for view in scene.cameras] == [folder / "clip.avi"] * 2
    assert scene.views() == scene.cameras
    wrong = head + camera.replace("[camera]", "[[camera]]") + second.replace("width = 384", "width = 0") + tail
    with pytest.raises(SceneError, match=r"camera\[2\]\.width = 0: wanted"):
        read_scene(scene_file(folder, wrong))


def test_a_moving_table_is_read_and_refused_where_it_must_be_at_rest(folder: Path) -> None:
    moving = 'surface = "wood"\nmotion = {amplitude_m = 0.001, frequency_hz = 25.0, phase_rad = 0.5}'
    scene = read_scene(scene_file(folder, SCENE.replace('surface = "wood"', moving)))
    assert scene.table.motion is not None
    assert scene.table.motion.frequency_hz == 25.0
    with pytest.raises(SceneError, match=r"table\.motion\.amplitude_m = 0\.001: "):
        scene.still_table()


def test_a_pattern_of_images_is_a_path_when_it_matches_something(folder: Path) -> None:
    text = SCENE.replace('"clip.avi"', '"frame_*.png"')
    with pytest.raises(SceneError, match="does not exist"):
        read_scene(scene_file(folder, text))
    (folder / "frame_0001.png").write_bytes(b"")
    assert read_scene(scene_file(folder, text)).clip.path == folder / "frame_*.png"


def test_frames_and_ranges_to_exclude_and_a_start_are_read(folder: Path) -> None:
    text = SCENE.replace("fps = 1500.0", "fps = 1500.0\nexclude = [[120, 131], 200]")
    clicks = "corners = [" + ", ".join(f"{{vertex = {k}, px = [{10 * k}, 20.5]}}" for k in range(4)) + "]"
    scene = read_scene(scene_file(folder, f"{text}[start]\nframe = 12\n{clicks}\n"))
    assert scene.clip.excluded == ((120, 131), (200, 201))
    assert scene.start is not None
    assert (scene.start.frame, scene.start.position_m) == (12, None)
    assert [(click.vertex, *click.px) for click in scene.start.clicks] == [(k, 10 * k, 20.5) for k in range(4)]
    assert read_scene(scene_file(folder, SCENE)).start is None


def test_a_path_leaves_the_folder_only_where_that_is_allowed(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "clip.avi"
    elsewhere.write_bytes(b"")
    path = scene_file(folder, SCENE.replace('"clip.avi"', f'"{elsewhere}"'))
    with pytest.raises(SceneError, match="--allow-outside"):
        read_scene(path)
    assert read_scene(path, allow_outside=True).clip.path == elsewhere
    # Inside by another spelling, and a link, which the owner of the folder made.
    (folder / "link.avi").symlink_to(elsewhere)
    for text in (str(folder / "clip.avi"), "link.avi", f"../{folder.name}/clip.avi"):
        assert read_scene(scene_file(folder, SCENE.replace("clip.avi", text))).clip.path is not None


def test_a_file_too_large_for_a_scene_is_not_read(folder: Path) -> None:
    path = scene_file(folder)
    with path.open("r+b") as file:
        file.truncate(2**40)  # a hole: a terabyte on no disk
    with pytest.raises(SceneError, match="1099511627776 bytes"):
        read_scene(path)


def test_how_well_a_scene_is_known_is_stated_or_that_of_a_careful_laboratory(folder: Path) -> None:
    usual = read_scene(scene_file(folder))
    known = usual.known_errors(1.0 / 1500.0)
    assert known.edge_share == pytest.approx(1e-3)
    assert known.clock_share == pytest.approx(1e-5)
    sigmas = np.sqrt(np.diag(known.covariances[0]))
    # 0.1 % of the focal length, 0.5 px of the centre, no distortion, 0.05 degrees and 0.3 mm.
    wanted = [2.7, 2.7, 0.5, 0.5, *[0.0] * 5, *[np.radians(0.05)] * 3, *[3e-4] * 3]
    np.testing.assert_allclose(sigmas, wanted, rtol=1e-9)
    (sentence,) = usual.assumptions
    for words in ("0.1 %", "0.5 px", "0.05 degrees", "0.3 mm", "camera.calibration", "die.edge_sigma_m"):
        assert words in sentence
    text = SCENE.replace("fps = 1500.0", "fps = 1500.0\nfps_sigma = 0.3").replace(
        "edge_m = 0.016", "edge_m = 0.016\nedge_sigma_m = 0.00004"
    )
    stated = read_scene(scene_file(folder, text.replace("[0.0, 0.02, 0.6]", '[0.0, 0.02, 0.6]\ncalibration = "exact"')))
    known = stated.known_errors(1.0 / 1500.0)
    assert known.edge_share == pytest.approx(0.0025)
    assert known.clock_share == pytest.approx(2e-4)
    assert not known.covariances[0].any()
    assert stated.assumptions == ()
    exact = usual.known_exactly()
    known = exact.known_errors(1.0 / 1500.0)
    assert (known.edge_share, known.clock_share, known.covariances[0].any()) == (0.0, 0.0, False)
    assert exact.assumptions == ()
