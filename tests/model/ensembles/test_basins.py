"""Maps of basins of attraction: pixels, zooms and final configurations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from diethrow.model.die.die import make_die
from diethrow.model.ensembles.basins import Axis, Window, final_configurations, map_rows
from diethrow.model.ensembles.landings import ENDING_OF_INDEX, ThrowSetup
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import matrix_from_quat, quat_from_euler
from diethrow.model.throw.body import unpacked_state
from diethrow.model.throw.simulate import Ending, Until, throw_die

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.02, 0.016)
WINDOW = Window(Axis("z0", 0.1, 0.4, 24), Axis("omega_eta", 0.0, 50.0, 30))
TETRAHEDRON = ThrowSetup(make_die("tetrahedron", 0.040793, 0.016), SmoothImpact(0.2))


def whole_map(setup: ThrowSetup, window: Window, rows: int = 8, threads: int = 1) -> NDArray[np.int64]:
    faces = np.concatenate([part.face for _, _, part in map_rows(setup, window, rows=rows, threads=threads)])
    return faces.reshape(window.y.pixels, window.x.pixels)


def test_a_zoom_is_the_crop_of_a_finer_map_pixel_for_pixel() -> None:
    # 0.2 and 0.3 are no doubles; a coordinate off in its last bit would show at this restitution.
    setup = ThrowSetup(TETRAHEDRON.die, SmoothImpact(0.7))
    finer = Window(Axis("z0", 0.1, 0.4, 90), Axis("omega_eta", 10.0, 40.0, 60))
    zoom = Window(Axis("z0", 0.2, 0.3, 30), Axis("omega_eta", 15.0, 25.0, 20))
    np.testing.assert_array_equal(zoom.x.centres, finer.x.centres[30:60])
    np.testing.assert_array_equal(whole_map(setup, zoom), whole_map(setup, finer)[10:30, 30:60])


def test_a_map_does_not_depend_on_threads_or_rows_at_once() -> None:
    expected = whole_map(TETRAHEDRON, WINDOW)
    np.testing.assert_array_equal(whole_map(TETRAHEDRON, WINDOW, rows=7, threads=3), expected)


def test_a_pixel_is_the_throw_from_its_centre() -> None:
    faces = whole_map(TETRAHEDRON, WINDOW)
    for row, column in ((0, 0), (3, 20), (17, 11), (29, 23)):
        z0, eta = WINDOW.x.centres[column], WINDOW.y.centres[row]
        quaternion = quat_from_euler([0.3, 1.2, 0.6])
        omega = matrix_from_quat(quaternion) @ [0.0, eta, 0.0]
        release = unpacked_state(np.concatenate([[0.0, 0.0, z0], quaternion, np.zeros(3), omega]), 0.0)
        assert throw_die(TETRAHEDRON.die, release, TETRAHEDRON.law).landed_face == faces[row, column]


def test_a_release_below_the_table_is_not_thrown() -> None:
    window = Window(Axis("z0", 0.0, 0.1, 10), Axis("theta", 0.0, 3.0, 4))
    (_, _, part), *_ = map_rows(TETRAHEDRON, window, rows=4)
    low = (part.ending == -1).reshape(4, 10)
    assert low[:, 0].all()
    assert not low[:, -1].any()
    assert (part.face[part.ending == -1] == 0).all()


def test_a_final_configuration_without_a_face_is_the_ending() -> None:
    setup = ThrowSetup(CUBE, SmoothImpact(1.0))
    bounces = -1 - ENDING_OF_INDEX.index(Ending.BOUNCING)
    points = np.array([[0.3, 20.0], [0.2, 1.0]])
    assert final_configurations(setup, WINDOW, points).tolist() == [bounces, bounces]
    alone = throw_die(CUBE, unpacked_state(WINDOW.states(points)[0], 0.0), setup.law, until=Until(impacts=4))
    down = CUBE.solid.normals @ matrix_from_quat(alone.throw.at(alone.throw.bounces[3].time_s).quaternion)[2]
    assert final_configurations(setup, WINDOW, points, after=4)[0] == int(down.argmin()) + 1


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Axis("z", 0.0, 1.0, 3), "axis 'z'"),
        (lambda: Axis("z0", 1.0, 1.0, 3), "z0 from 1.0 to 1.0"),
        (lambda: Axis("z0", 0.0, 1.0, 0), "z0 in 0 pixels"),
        (lambda: Window(Axis("z0", 0.1, 1.0, 3), Axis("z0", 0.1, 1.0, 3)), "axes z0 and z0"),
        (lambda: Window(Axis("z0", 0.1, 1.0, 3), Axis("psi", 0.1, 1.0, 3), {"tetha": 1.0}), "fixed condition 'tetha'"),
        (lambda: Window(Axis("z0", 0.1, 1.0, 100_000), Axis("psi", 0.1, 1.0, 100_000)), "100000 × 100000 pixels"),
    ],
)
def test_impossible_windows_raise_and_name_the_value(make: Callable[[], object], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        make()
