"""Which face is which: pips counted and numbers read on the learned textures of a die's faces.

*Pips.* A pip is a round spot that is darker, or lighter, than the paint around it. Patterns of one to six pips go over into
themselves under half a turn about the middle of the face, and odd ones have a pip there: what does not is no pattern.
The faces are not judged one by one. The 24 numberings of a right-handed die (opposite faces add up to seven; 1, 2, 3 turn
counter-clockwise round their common corner) and the 24 of a left-handed one are weighed against all counts together,
so that faces which the film never showed are known as well.

*Numbers.* The shape of the marks, brought to a common centre and size, is compared with numbers drawn in common fonts, turned
to any angle, by normalised correlation. Numbers on one die are all different: the best assignment of all faces together is
taken, and only those of its numbers are claimed that no other number comes near. 6 and 9 are one shape: where both occur
they are drawn with the dot or bar that tells them apart, and without it neither stands out. Where every pair of opposite
faces that was read has the same sum, one more than the number of faces, unread faces follow from their opposites.

What is not clear is not claimed: the die then keeps its symmetric numbering, and `verdict` says why.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ...model.die import Die, Solid, numbered_solid, symmetry_rotations
from .textures import FaceGrid, Marks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEEN_SHARE = 0.7
"""Share of a face's flat part that must be known for its marks to be read."""
PIP_SMALLEST, PIP_LARGEST = 0.03, 0.2
"""Radius of a pip over the edge of the die: 0.07 to 0.1 is usual, and 0.15 for the one of Eastern dice."""
ROUND = 0.65
"""Least area of a pip over that of the circle round it; a square has 0.64."""
ASTRAY = 0.06
"""How far, over the edge, a pip may lie from where half a turn takes another one."""
RIGHT, DOUBTFUL = 0.97, 0.5
"""Chance that a count is right where the pattern is one of pips, and where it is not."""
LEFT_HANDED = 0.01
"""Chance, before looking, that a die said to be a Western one is left-handed after all."""
FAINTEST = 0.1
"""Least share of the paint's light that a mark takes away or adds."""
SURE = 0.95
"""Chance from which a numbering is claimed."""
PATCH = 32
"""Side of the patches that numbers are compared on."""
REACH = 2.6
"""Half of that side in root mean square radii of the marks: figures end at 1.5 to 2.2."""
TURNS = 72
"""Angles at which a number is compared: 5 degrees change a correlation by less than 0.03."""
COARSE_PX = 5.0
"""Blur [pixels of a patch] beyond which shape is coarse: strokes are 3 to 5 wide, figures 10 to 25."""
BLURS = (0.8, 1.3, 2.0)
SIZES = (0.85, 0.92, 1.0, 1.08)
"""Blurs [pixels of a patch] and sizes at which a drawn number is compared: what was seen is blurred, which widens it as well."""
WORTH_A_LOOK = 0.15
"""Numbers whose first correlation lies further below the best are not compared more closely, which gains 0.1 at the most."""
ALIKE, CLEARER = 0.8, 0.03
"""Correlation from which a number counts as read, and by which it must exceed every other number's."""
FONTS = ("DejaVu Sans", "DejaVu Serif")
"""They come with matplotlib; a sans and a serif face, drawn bold, are near enough to what is engraved on dice."""


@dataclass(frozen=True)
class FaceNumbers:
    """The numbers on the faces of a die, as far as they can be read."""

    numbers: tuple[int | None, ...]
    """For each face of the solid that was tracked, in its order; None where it is not known."""
    probability: float
    """That all claimed numbers are right; 0 where none is."""
    verdict: str
    """One sentence: what was read, or why the numbering stays symmetric."""

    @property
    def complete(self) -> bool:
        """Whether every face has its number."""
        return sorted(n for n in self.numbers if n is not None) == list(range(1, len(self.numbers) + 1))


def read_faces(die: Die, marks: Marks | None) -> FaceNumbers:
    """The numbers that a die carries, read from the textures learned of it (`marks` None where it showed none)."""
    count = len(die.solid.faces)
    if marks is None or not len(marks.marked_faces):
        return _symmetric(count, "the faces show no marks")
    if die.marks is None:
        return _symmetric(count, "the die is said to be plain; name its marks to have them read")
    if die.marks == "pips":
        if die.solid.name != "cube":
            return _symmetric(count, f"pips are read on cubes alone, and this is a {die.solid.name}")
        return _numbering([count_pips(marks, f, die.solid.edge_m) for f in range(count)], die.solid)
    return _read_numbers(die.solid, marks)


def with_numbers(die: Die, faces: FaceNumbers) -> Die:
    """The die with its faces in the order of their own numbers, so that face k carries k + 1; the same die where they
    are not all known. Vertices, and with them every pose, stay as they are."""
    if not faces.complete:
        return die
    return replace(die, solid=numbered_solid(die.solid, [int(n) for n in faces.numbers if n is not None]))


def _symmetric(count: int, why: str) -> FaceNumbers:
    return FaceNumbers((None,) * count, 0.0, f"The numbering stays symmetric: {why}.")


# --- pips ---


@dataclass(frozen=True)
class PipCount:
    """The pips of one face."""

    count: int
    is_pattern: bool
    """Whether they lie as pips do."""


def count_pips(marks: Marks, face: int, edge_m: float) -> PipCount | None:
    """The pips on one face, or None where too little of it was seen."""
    spots = _spots(marks, face)
    if spots is None:
        return None
    grid = marks.grid
    number, labels, stats, centres = cv2.connectedComponentsWithStats(spots.astype(np.uint8), connectivity=4)
    low, high = (np.pi * (share * edge_m / grid.texel_m) ** 2 for share in (PIP_SMALLEST, PIP_LARGEST))
    found, strange = [], False
    for k in range(1, number):
        area = float(stats[k, cv2.CC_STAT_AREA])
        if area < low:
            continue
        rows, columns = np.nonzero(labels == k)
        # Half a texel on either side belongs to the spot as well.
        reach = float(np.hypot(columns - centres[k, 0], rows - centres[k, 1]).max()) + 0.5
        if area > high or area < ROUND * np.pi * reach**2:
            strange = True
            continue
        found.append((np.asarray(centres[k]) - 0.5 * (grid.size - 1)) * grid.texel_m / edge_m)
    return PipCount(len(found), 1 <= len(found) <= 6 and not strange and _is_pattern(np.array(found)))


def _is_pattern(places: Array) -> bool:
    """Whether places (n, 2), in edges from the middle, go over into themselves under half a turn, an odd one in the middle."""
    apart = np.linalg.norm(places[:, None] + places[None], axis=2)
    rows, columns = linear_sum_assignment(apart)
    central = int((np.linalg.norm(places, axis=1) < ASTRAY).sum())
    return bool(apart[rows, columns].max() < 2.0 * ASTRAY) and central == len(places) % 2


def _spots(marks: Marks, face: int) -> Mask | None:
    """(n, n) what differs from the paint by more than half of what the marks do; None where too little was seen."""
    texture = marks.texture[face]
    flat = _flat_part(marks.grid, face)
    known = np.isfinite(texture) & flat
    if known.sum() < SEEN_SHARE * flat.sum():
        return None
    away = np.where(known, texture - np.median(texture[known]), 0.0)
    darkest, lightest = np.percentile(away[known], [1.0, 99.0])
    away, depth = (-away, -darkest) if -darkest > lightest else (away, lightest)
    if marks.noise_grey[face] == 0.0 or depth < FAINTEST:
        return np.zeros_like(known)
    return np.asarray((away > 0.5 * depth) & known)


def _flat_part(grid: FaceGrid, face: int) -> Mask:
    """(n, n) texels inside the flat part of a face, without the border on which no frame looks (two texels)."""
    corners = grid.corners[face, : grid.counts[face]] / grid.texel_m + 0.5 * (grid.size - 1)
    picture = np.zeros((grid.size, grid.size), np.uint8)
    cv2.fillConvexPoly(picture, np.rint(corners).astype(np.int32), 1)
    return cv2.erode(picture, np.ones((5, 5), np.uint8), borderValue=0).astype(bool)


def _numbering(counts: list[PipCount | None], solid: Solid) -> FaceNumbers:
    """The numbering of a cube that all counts together bear out."""
    right = np.array([_carried(solid, turn) + 1 for turn in symmetry_rotations(solid)])
    # Opposite numbers exchanged make the mirror image.
    numberings = np.concatenate([right, 7 - right])
    prior = np.repeat([(1.0 - LEFT_HANDED) / len(right), LEFT_HANDED / len(right)], len(right))
    chance = prior.copy()
    read = 0
    for f, seen in enumerate(counts):
        if seen is None or not 1 <= seen.count <= 6:
            continue
        sure = RIGHT if seen.is_pattern else DOUBTFUL
        read += int(seen.is_pattern)
        chance *= np.where(numberings[:, f] == seen.count, sure, (1.0 - sure) / 5.0)
    likelihood = float(chance.sum())
    best = int(np.argmax(chance))
    probability = float(chance[best]) / likelihood
    shown = ", ".join("?" if c is None else str(c.count) for c in counts)
    if read < 2:
        return _symmetric(len(counts), f"pips can be counted on {read} of its faces (counts: {shown})")
    if probability < SURE:
        return _symmetric(
            len(counts), f"the counts {shown} fit several numberings, the best with a probability of {probability:.2f}"
        )
    wrong = sum(c is not None and c.is_pattern and c.count != n for c, n in zip(counts, numberings[best], strict=True))
    if wrong:
        return _symmetric(
            len(counts), f"the counts {shown} are not those of a die whose opposite faces add up to seven"
        )
    hand = "right-handed" if best < len(right) else "left-handed"
    return FaceNumbers(
        tuple(int(n) for n in numberings[best]),
        probability,
        f"Pips were counted on {read} of 6 faces, those of a {hand} die (probability {probability:.3f}).",
    )


def _carried(solid: Solid, turn: Array) -> NDArray[np.int64]:
    """(faces,) index of the face onto which a rotation of the solid carries each face."""
    return np.argmax((solid.normals @ turn.T) @ solid.normals.T, axis=1)


# --- numbers ---


def _read_numbers(solid: Solid, marks: Marks) -> FaceNumbers:
    """The numbers on the faces, each as far as it is clear."""
    count = len(solid.faces)
    patches = {f: patch for f in range(count) if (patch := _figure(marks, f)) is not None}
    if not patches:
        return _symmetric(count, "no face was seen well enough to read its number")
    alike = np.zeros((count, count))
    for f, patch in patches.items():
        alike[f] = _likeness(patch, count)
    faces, chosen = linear_sum_assignment(-alike)
    numbers: list[int | None] = [None] * count
    for f, k in zip(faces.tolist(), chosen.tolist(), strict=True):
        others = np.delete(alike[f], k)
        if alike[f, k] >= ALIKE and alike[f, k] - others.max() >= CLEARER:
            numbers[f] = k + 1
    read = sum(n is not None for n in numbers)
    if read == 0:
        return _symmetric(count, "no number stands out clearly enough from the others")
    numbers, inferred = _with_opposites(solid, numbers)
    known = sum(n is not None for n in numbers)
    margins = [alike[f, n - 1] - np.delete(alike[f], n - 1).max() for f, n in enumerate(numbers) if n and f in patches]
    # A margin of CLEARER is the least that is claimed, three times as much is beyond doubt.
    probability = float(np.prod([1.0 - 0.1 * np.exp(-max(m, 0.0) / CLEARER) for m in margins]))
    rest = "" if known == count else f"; {count - known} are not known, and the numbering of the die stays symmetric"
    return FaceNumbers(tuple(numbers), probability, f"Numbers were read on {read} of {count} faces{inferred}{rest}.")


def _with_opposites(solid: Solid, numbers: list[int | None]) -> tuple[list[int | None], str]:
    """The numbers with those of unread faces from their opposites, where all pairs that were read allow it."""
    count = len(numbers)
    opposite = np.argmin(solid.normals @ solid.normals.T, axis=1)
    if (solid.normals @ solid.normals.T).min(axis=1).max() > -1.0 + 1e-9:
        return numbers, ""
    pairs = [(numbers[f], numbers[o]) for f, o in enumerate(opposite) if f < o]
    sums = [a + b for a, b in pairs if a is not None and b is not None]
    if not sums or any(s != count + 1 for s in sums):
        return numbers, ""
    out = list(numbers)
    for f, o in enumerate(opposite.tolist()):
        other = numbers[o]
        if out[f] is None and other is not None:
            out[f] = count + 1 - other
    if len({n for n in out if n is not None}) < sum(n is not None for n in out):
        return numbers, ""
    found = sum(a is None and b is not None for a, b in zip(numbers, out, strict=True))
    return out, f", and {found} follow from their opposites" if found else ""


def _figure(marks: Marks, face: int) -> Array | None:
    """The marks of a face as a patch (PATCH, PATCH) of ink, of their own centre and size; None where there are none."""
    if marks.noise_grey[face] == 0.0:
        return None
    spots = _spots(marks, face)
    if spots is None or not spots.any():
        return None
    texture = marks.texture[face]
    away = np.abs(np.where(np.isfinite(texture), texture - np.nanmedian(texture), 0.0))
    # Shading at the border is no figure.
    near = cv2.dilate(spots.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    # Face coordinates run up, pictures down: the texture is turned over to be read.
    return _patch((away * near)[::-1])


def _patch(ink: Array) -> Array | None:
    """An image of ink on nothing, moved to its centroid and scaled to its root mean square radius."""
    total = float(ink.sum())
    if total <= 0.0:
        return None
    rows, columns = np.mgrid[0 : ink.shape[0], 0 : ink.shape[1]]
    y, x = float((ink * rows).sum() / total), float((ink * columns).sum() / total)
    radius = float(np.sqrt((ink * ((rows - y) ** 2 + (columns - x) ** 2)).sum() / total))
    if radius < 1.5:
        return None
    scale = REACH * radius / (0.5 * PATCH)
    place = np.array([[scale, 0.0, x - scale * 0.5 * (PATCH - 1)], [0.0, scale, y - scale * 0.5 * (PATCH - 1)]])
    return cv2.warpAffine(ink, place, (PATCH, PATCH), flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP).astype(float)


def _details(patch: Array, blur: float) -> Array:
    """The patch blurred, its coarse shape taken out (any two figures are alike in that), zero mean and unit power."""
    soft = cv2.GaussianBlur(patch, (0, 0), blur)
    soft = soft - cv2.GaussianBlur(soft, (0, 0), COARSE_PX)
    soft = soft - soft.mean()
    return np.asarray(soft / np.linalg.norm(soft))


def _likeness(patch: Array, count: int) -> Array:
    """(count,) best correlation of a patch with each number, over fonts, turns, small shifts and sizes, and sharpness."""
    seen = _details(patch, BLURS[1]).astype(np.float32)
    shifts = _shifted(_details(patch, BLURS[0]))
    rough = [(turned @ seen.ravel(), number, drawn) for number, drawn, turned in _drawn_numbers(count)]
    near = max(float(alike.max()) for alike, _, _ in rough) - WORTH_A_LOOK
    best = np.full(count, -1.0)
    for alike, number, drawn in rough:
        best[number - 1] = max(best[number - 1], float(alike.max()))
        if alike.max() > near:
            closest = max(_closest(drawn, 360.0 * k / TURNS, shifts) for k in _best_turns(alike))
            best[number - 1] = max(best[number - 1], closest)
    return best


def _best_turns(alike: NDArray[np.float32]) -> list[int]:
    """The best of all turns, and the best of those more than 30 degrees from it."""
    first = int(np.argmax(alike))
    away = np.abs((np.arange(TURNS) - first + TURNS // 2) % TURNS - TURNS // 2) > TURNS // 12
    return [first, int(np.argmax(np.where(away, alike, -1.0)))]


def _shifted(patch: Array) -> NDArray[np.float32]:
    """(25, PATCH²) the patch moved by up to two pixels each way."""
    moves = [np.roll(patch, (i, j), (0, 1)).ravel() for i in range(-2, 3) for j in range(-2, 3)]
    return np.array(moves, np.float32)


def _closest(drawn: Array, degrees: float, seen: NDArray[np.float32]) -> float:
    """Best correlation of a drawn number, about one turn, with a patch and its shifts."""
    middle = 0.5 * (PATCH - 1)
    best = -1.0
    for size in SIZES:
        for turn in (-3.0, 0.0, 3.0):
            place = cv2.getRotationMatrix2D((middle, middle), degrees + turn, size)
            placed = cv2.warpAffine(drawn, place, (PATCH, PATCH))
            for blur in BLURS:
                best = max(best, float((seen @ _details(placed, blur).astype(np.float32).ravel()).max()))
    return best


@cache
def _drawn_numbers(count: int) -> tuple[tuple[int, Array, NDArray[np.float32]], ...]:
    """Numbers 1 to `count` in all fonts, each as drawn and (TURNS, PATCH²) at all angles; 6 and 9 with bar and dot where
    both occur."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    out = []
    for font in FONTS:
        for number in range(1, count + 1):
            words = [str(number)]
            if count >= 9 and number in (6, 9):
                words = [f"{number}.", f"{number}_"]
            for word in words:
                path = TextPath(
                    (0.0, 0.0), word.replace("_", ""), 100.0, prop=FontProperties(family=font, weight="bold")
                )
                patch = _patch(_ink([np.asarray(p, float) for p in path.to_polygons()], bar=word.endswith("_")))
                assert patch is not None
                out.append((number, patch, _turned(patch)))
    return tuple(out)


def _ink(polygons: list[Array], bar: bool) -> Array:
    """Filled outlines, holes left out, the y axis downwards; with a bar below the figure."""
    points = np.concatenate(polygons)
    low, high = points.min(0) - 30.0, points.max(0) + 30.0
    picture = np.zeros((int(high[1] - low[1]), int(high[0] - low[0])), np.uint8)
    outlines = [np.rint((p - low) * [1, -1] + [0, high[1] - low[1]]).astype(np.int32) for p in polygons]
    cv2.fillPoly(picture, outlines, 1)
    if bar:
        left, right = (int(v) for v in (points[:, 0].min() - low[0], points[:, 0].max() - low[0]))
        bottom = int(high[1] - points[:, 1].min())
        picture[bottom + 8 : bottom + 18, left:right] = 1
    return picture.astype(float)


def _turned(patch: Array) -> NDArray[np.float32]:
    """The details of a patch at TURNS angles (TURNS, PATCH²)."""
    middle = 0.5 * (PATCH - 1)
    out = []
    for k in range(TURNS):
        turn = cv2.getRotationMatrix2D((middle, middle), 360.0 * k / TURNS, 1.0)
        out.append(_details(cv2.warpAffine(patch, turn, (PATCH, PATCH)), BLURS[1]).ravel())
    return np.array(out, np.float32)
