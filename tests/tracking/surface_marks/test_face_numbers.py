"""Laws of reading faces: the numbers of the die under any labelling, and no result if they are not clear."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from footage_of_throws import DICE, PIPS
from marked_throws import CUBE, learned_marks
from numpy.typing import NDArray

from diethrow.model.die.die import Die
from diethrow.model.die.solid import Solid, lowest_face, numbered_solid
from diethrow.model.die.symmetry import symmetry_rotations
from diethrow.tracking.surface_marks.face_numbers import FaceNumbers, count_pips, read_faces, with_numbers
from diethrow.tracking.surface_marks.textures import FaceGrid, SurfaceMarks, face_axes

Array = NDArray[np.float64]

SIZE = 81
"""Texels of a drawn face along a side: as large as a die of 60 px shows its faces."""


def blank_marks(die: Die) -> SurfaceMarks:
    """Textures of bare paint with little noise, all of them known."""
    solid = die.solid
    count, edge = len(solid.faces), solid.edge_m
    axes = face_axes(solid)
    texel = (
        2.3 * np.linalg.norm(solid.vertices[list(solid.faces[0])].mean(0) - solid.vertices[solid.faces[0][0]]) / SIZE
    )
    most = max(len(face) for face in solid.faces)
    corners = np.zeros((count, most, 2))
    for f, face in enumerate(solid.faces):
        corners[f, : len(face)] = solid.vertices[list(face)] @ axes[f, :2].T
    grid = FaceGrid(axes, solid.offsets, corners, np.array([len(face) for face in solid.faces]), SIZE, float(texel))
    texture = 1.0 + 0.01 * np.random.default_rng(2).standard_normal((count, SIZE, SIZE))
    assert edge > 10 * texel
    return SurfaceMarks(
        grid, texture, texture, np.ones(texture.shape, np.uint8), np.full(count, 3.0), np.full(count, 50),
        np.zeros((1, 1, 2), np.float32), 255.0, 0.7, np.zeros((count, 2, 3)), 1.0, 1e-5, (), (),
    )  # fmt: skip


def with_pips(marks: SurfaceMarks, die: Die, numbers: list[int]) -> SurfaceMarks:
    texture = marks.texture.copy()
    half, edge_px = 0.5 * (SIZE - 1), die.solid.edge_m / marks.grid.texel_m
    v, u = np.mgrid[0:SIZE, 0:SIZE]
    for f, number in enumerate(numbers):
        turned = f % 4
        for place in PIPS[number]:
            x, y = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), turned) @ (0.25 * edge_px * np.array(place))
            texture[f][np.hypot(u - half - x, v - half - y) < 0.09 * edge_px] = 0.2
        texture[f] = cv2.GaussianBlur(texture[f], (0, 0), 1.0)
    return replace(marks, texture=texture)


def with_figures(marks: SurfaceMarks, words: list[str]) -> SurfaceMarks:
    """Numbers drawn in another font than those they are compared with, at random angles."""
    texture = marks.texture.copy()
    rng = np.random.default_rng(5)
    for f, word in enumerate(words):
        big = np.zeros((4 * SIZE, 4 * SIZE), np.uint8)
        (width, height), _ = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, 3.2, 14)
        origin = ((4 * SIZE - width) // 2, (4 * SIZE + height) // 2)
        cv2.putText(big, word, origin, cv2.FONT_HERSHEY_SIMPLEX, 3.2, 255, 14, cv2.LINE_AA)
        turn = cv2.getRotationMatrix2D((2 * SIZE, 2 * SIZE), float(rng.uniform(0, 360)), 1.0)
        small = cv2.resize(cv2.warpAffine(big, turn, big.shape), (SIZE, SIZE), interpolation=cv2.INTER_AREA) / 255.0
        # Rows of pictures run downwards, those of face coordinates upwards.
        texture[f] -= 0.8 * cv2.GaussianBlur(small, (0, 0), 1.0)[::-1]
    return replace(marks, texture=texture)


@cache
def blank_cube() -> SurfaceMarks:
    return blank_marks(CUBE)


@pytest.mark.parametrize("k", [0, 5, 11, 18, 23])
def test_pips_are_read_under_any_labelling(k: int) -> None:
    turn = symmetry_rotations(CUBE.solid)[k]
    carried = np.argmax((CUBE.solid.normals @ turn.T) @ CUBE.solid.normals.T, axis=1)
    numbers = [int(n) + 1 for n in carried]
    faces = read_faces(CUBE, with_pips(blank_cube(), CUBE, numbers))
    assert faces.numbers == tuple(numbers)
    assert faces.complete
    assert faces.probability > 0.99
    assert "right-handed" in faces.verdict


def test_numbers_of_faces_that_were_never_seen_follow_from_the_others() -> None:
    marks = with_pips(blank_cube(), CUBE, [1, 2, 3, 4, 5, 6])
    texture = marks.texture.copy()
    texture[[2, 3, 5]] = np.nan
    faces = read_faces(CUBE, replace(marks, texture=texture))
    assert faces.numbers == (1, 2, 3, 4, 5, 6)
    assert "3 of 6" in faces.verdict


def test_a_left_handed_die_is_recognised() -> None:
    faces = read_faces(CUBE, with_pips(blank_cube(), CUBE, [1, 3, 2, 5, 4, 6]))
    assert faces.numbers == (1, 3, 2, 5, 4, 6)
    assert "left-handed" in faces.verdict


@pytest.mark.parametrize(
    ("marks", "reason"),
    [
        (None, "no marks"),
        (blank_cube(), "0 of its faces"),
        (with_pips(blank_cube(), CUBE, [1, 2, 1, 2, 1, 2]), "fit several|not those of a die"),
        (replace(blank_cube(), noise_grey=np.zeros(6)), "no marks"),
    ],
)
def test_unreadable_faces_keep_the_symmetric_numbering_with_the_reason(marks: SurfaceMarks | None, reason: str) -> None:
    faces = read_faces(CUBE, marks)
    assert faces.numbers == (None,) * 6
    assert faces.probability == 0.0
    assert any(part in faces.verdict for part in reason.split("|"))
    assert with_numbers(CUBE, faces) is CUBE


def test_marks_other_than_pips_are_not_counted_as_pips() -> None:
    figures = with_figures(blank_cube(), ["7", "4", "1", "A", "E", "T"])
    assert not any(
        count is not None and count.is_pattern for count in (count_pips(figures, f, 0.0127) for f in range(6))
    )


def test_pips_learned_from_a_clip_are_read() -> None:
    faces = read_faces(CUBE, learned_marks()[0])
    assert faces.numbers == (1, 2, 3, 4, 5, 6)


def test_numbers_are_read_in_another_font_at_any_angle() -> None:
    die = replace(DICE["octahedron"], marks="numbers")
    words = ["3", "7", "1", "8", "2", "5", "4", "6"]
    faces = read_faces(die, with_figures(blank_marks(die), words))
    reported = {f: n for f, n in enumerate(faces.numbers) if n is not None}
    # Not all need be clear, but those that are reported must be right.
    assert all(n == int(words[f]) for f, n in reported.items())
    assert len(reported) >= 5


def test_no_number_is_reported_on_faces_without_figures() -> None:
    die = replace(DICE["octahedron"], marks="numbers")
    assert read_faces(die, blank_marks(die)).numbers == (None,) * 8


def test_a_numbered_die_lands_on_its_own_number_and_keeps_its_vertices() -> None:
    numbers = (5, 1, 3, 4, 6, 2)
    die = with_numbers(CUBE, FaceNumbers(numbers, 1.0, ""))
    assert die.solid.vertices is CUBE.solid.vertices
    for turn in symmetry_rotations(CUBE.solid):
        assert lowest_face(die.solid, turn) == numbers[lowest_face(CUBE.solid, turn) - 1]
    along = [tuple(sorted(pair)) for pair in die.solid.edge_faces.tolist()]
    assert sorted(along) == sorted(tuple(sorted(pair)) for pair in neighbours(die.solid))


def neighbours(solid: Solid) -> list[tuple[int, int]]:
    """Pairs of faces that share two vertices."""
    faces = [set(face) for face in solid.faces]
    return [(i, j) for i in range(len(faces)) for j in range(i) if len(faces[i] & faces[j]) == 2]


@pytest.mark.parametrize("numbers", [[1, 2, 3, 4, 5, 5], [1, 2, 3], [0, 1, 2, 3, 4, 5]])
def test_numbers_other_than_one_to_six_once_each_are_refused(numbers: list[int]) -> None:
    with pytest.raises(ValueError, match="1 to 6"):
        numbered_solid(CUBE.solid, numbers)
