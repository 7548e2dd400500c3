"""Which number each face carries: pips counted and numbers read on the learned textures.

**Pips.** A pip is a round spot that is darker, or lighter, than the paint around it. Patterns of one to six pips are
symmetric under half a turn about the middle of the face, and odd ones have a pip there; other patterns are not pips.
Faces are not judged one by one: the 24 numberings of a right-handed die (opposite faces add up to seven; 1, 2, 3 run
counter-clockwise round their common corner) and the 24 of a left-handed one are compared with all counts together by
Bayes' rule. Faces that the clip never shows follow from that.

**Numbers.** The shape of the marks, moved to a common centre and size, is compared with numbers drawn in common
fonts, rotated to any angle, by normalised correlation. The numbers on one die differ: the best assignment of all
faces together is taken, and of its numbers those are reported that exceed every other number clearly. 6 and 9 have
the same shape: where both occur they are drawn with the dot or bar that distinguishes them, and without it neither is
reported. If every pair of opposite faces that was read has the same sum, one more than the number of faces, unread
faces follow from their opposites.

A numbering that is not clear is not reported: the die keeps its symmetric numbering, and `verdict` gives the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ...model.die import Die, Solid, symmetry_rotations
from .textures import SPLINE_TEXELS, FaceGrid, SurfaceMarks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

KNOWN_SHARE = 0.7
"""Share of a face's flat part that must be known for its marks to be read."""
LEAST_PIP_RADIUS = 0.03
"""Over the die's edge; 0.07 to 0.1 is usual."""
LARGEST_PIP_RADIUS = 0.2
"""Over the die's edge; the one of Eastern dice has 0.15."""
LEAST_ROUNDNESS = 0.65
"""Least area of a pip over that of its circumscribed circle; a square has 0.64."""
PIP_TOLERANCE = 0.06
"""How far, over the edge, a pip may lie from where half a turn takes another one."""
PATTERN_RELIABILITY = 0.97
"""Probability that a count is right if its pattern is one of pips."""
OTHER_RELIABILITY = 0.5
"""Probability that a count is right if its pattern is not one of pips."""
LEFT_HANDED_PRIOR = 0.01
"""Prior probability that a die described as a Western one is left-handed."""
LEAST_CONTRAST = 0.1
"""Least share of the paint's light that a mark takes away or adds."""
CONTRAST_PERCENTILES = (1.0, 99.0)
"""Of the differences from the paint, between which those of marks lie: single texels may be wrong."""
LEAST_PROBABILITY = 0.95
"""Least posterior probability of a numbering that is reported."""
FEWEST_COUNTED = 2
"""Least number of faces with a pattern of pips."""
PATCH = 32
"""Side of the patches on which numbers are compared [pixels]."""
PATCH_RADII = 2.6
"""Half of that side in root mean square radii of the marks: figures end at 1.5 to 2.2."""
LEAST_RADIUS_TEXELS = 1.5
"""Root mean square radius below which marks are too small to be read."""
ANGLES = 72
"""Angles at which a number is compared: 5 degrees change a correlation by less than 0.03."""
COARSE_PX = 5.0
"""Blur [pixels of a patch] beyond which shape is coarse: strokes are 3 to 5 wide, figures 10 to 25."""
BLURS_PX = (0.8, 1.3, 2.0)
"""Blurs [pixels of a patch] at which a drawn number is compared with a texture, which is blurred itself."""
MIDDLE_BLUR_PX = BLURS_PX[1]
"""Blur of both in the first comparison, at all angles."""
SIZES = (0.85, 0.92, 1.0, 1.08)
"""Sizes at which it is compared: blur makes a figure wider as well."""
SECOND_ANGLE_DEG = 30.0
"""Least difference of the two angles about which the comparison is refined."""
FINE_ANGLES_DEG = (-3.0, 0.0, 3.0)
"""Angles about the best one at which it is compared."""
FINE_SHIFT_PX = 2
"""Largest shift [pixels of a patch] at which it is compared."""
REFINED_WITHIN = 0.15
"""Numbers whose first correlation lies further below the best are not refined: the refinement gains 0.1 at most."""
LEAST_CORRELATION = 0.8
"""Correlation from which a number counts as read."""
LEAST_MARGIN = 0.03
"""By how much that correlation must exceed every other number's."""
DOUBT = 0.1
"""Probability that a number without any margin is wrong; it falls by e for each LEAST_MARGIN, of which three are
beyond doubt."""
FONTS = ("DejaVu Sans", "DejaVu Serif")
"""Supplied with matplotlib: a sans and a serif face, drawn bold, are near enough to what is engraved on dice."""


@dataclass(frozen=True)
class FaceNumbers:
    """The numbers on the faces of a die, as far as they can be read."""

    numbers: tuple[int | None, ...]
    """For each face of the tracked solid, in its order; None if it is not known."""
    probability: float
    """That all reported numbers are right; 0 if there are none."""
    verdict: str
    """One sentence: what was read, or why the numbering stays symmetric."""

    @property
    def complete(self) -> bool:
        """Whether every face has its number."""
        return sorted(n for n in self.numbers if n is not None) == list(range(1, len(self.numbers) + 1))


def read_faces(die: Die, marks: SurfaceMarks | None) -> FaceNumbers:
    """The numbers that a die carries, read from its learned textures (`marks` None if it has none)."""
    count = len(die.solid.faces)
    if marks is None or not len(marks.marked_faces):
        return _symmetric(count, "the faces show no marks")
    if die.marks is None:
        return _symmetric(count, "the die is described as plain; set its marks to have them read")
    if die.marks == "pips":
        if die.solid.name != "cube":
            return _symmetric(count, f"pips are read on cubes only, and this is a {die.solid.name}")
        return _numbering([count_pips(marks, f, die.solid.edge_m) for f in range(count)], die.solid)
    return _read_numbers(die.solid, marks)


def with_numbers(die: Die, faces: FaceNumbers) -> Die:
    """The die with its faces in the order of their numbers, so that face k carries k + 1; the same die if they are
    not all known. Vertices, and with them all poses, stay as they are."""
    if not faces.complete:
        return die
    return die.with_numbers([int(n) for n in faces.numbers if n is not None])


def _symmetric(count: int, why: str) -> FaceNumbers:
    return FaceNumbers((None,) * count, 0.0, f"The numbering stays symmetric: {why}.")


# --- pips ---


@dataclass(frozen=True)
class PipCount:
    """The pips of one face."""

    count: int
    is_pattern: bool
    """Whether they are arranged as pips are."""


def count_pips(marks: SurfaceMarks, face: int, edge_m: float) -> PipCount | None:
    """The pips on one face, or None if less than KNOWN_SHARE of it is known."""
    spots = _spots(marks, face)
    if spots is None:
        return None
    grid = marks.grid
    number, labels, stats, centres = cv2.connectedComponentsWithStats(spots.astype(np.uint8), connectivity=4)
    low, high = (np.pi * (share * edge_m / grid.texel_m) ** 2 for share in (LEAST_PIP_RADIUS, LARGEST_PIP_RADIUS))
    found, others = [], False
    for k in range(1, number):
        area = float(stats[k, cv2.CC_STAT_AREA])
        if area < low:
            continue
        rows, columns = np.nonzero(labels == k)
        # Spots reach half a texel beyond the centres of their outermost texels.
        reach = float(np.hypot(columns - centres[k, 0], rows - centres[k, 1]).max()) + 0.5
        if area > high or area < LEAST_ROUNDNESS * np.pi * reach**2:
            others = True
            continue
        found.append((np.asarray(centres[k]) - 0.5 * (grid.size - 1)) * grid.texel_m / edge_m)
    return PipCount(len(found), 1 <= len(found) <= 6 and not others and _is_pattern(np.array(found)))


def _is_pattern(places: Array) -> bool:
    """Whether places (n, 2), in edges from the middle, are symmetric under half a turn, with an odd one in the
    middle."""
    apart = np.linalg.norm(places[:, None] + places[None], axis=2)
    rows, columns = linear_sum_assignment(apart)
    central = int((np.linalg.norm(places, axis=1) < PIP_TOLERANCE).sum())
    return bool(apart[rows, columns].max() < 2.0 * PIP_TOLERANCE) and central == len(places) % 2


def _spots(marks: SurfaceMarks, face: int) -> Mask | None:
    """(n, n) texels that differ from the paint by more than half of the marks' contrast; None if too little is
    known."""
    texture = marks.texture[face]
    flat = _flat_part(marks.grid, face)
    known = np.isfinite(texture) & flat
    if known.sum() < KNOWN_SHARE * flat.sum():
        return None
    difference = np.where(known, texture - np.median(texture[known]), 0.0)
    darkest, lightest = np.percentile(difference[known], CONTRAST_PERCENTILES)
    difference, contrast = (-difference, -darkest) if -darkest > lightest else (difference, lightest)
    if marks.noise_grey[face] == 0.0 or contrast < LEAST_CONTRAST:
        return np.zeros_like(known)
    return np.asarray((difference > 0.5 * contrast) & known)


def _flat_part(grid: FaceGrid, face: int) -> Mask:
    """(n, n) texels inside the flat part of a face, without the border of two texels that no frame uses."""
    corners = grid.corners[face, : grid.counts[face]] / grid.texel_m + 0.5 * (grid.size - 1)
    picture = np.zeros((grid.size, grid.size), np.uint8)
    cv2.fillConvexPoly(picture, np.rint(corners).astype(np.int32), 1)
    return cv2.erode(picture, np.ones((SPLINE_TEXELS, SPLINE_TEXELS), np.uint8), borderValue=0).astype(bool)


def _numbering(counts: list[PipCount | None], solid: Solid) -> FaceNumbers:
    """The numbering of a cube that is most probable given all counts."""
    right = np.array([_carried(solid, turn) + 1 for turn in symmetry_rotations(solid)])
    # Exchanging opposite numbers gives the mirror image.
    numberings = np.concatenate([right, 7 - right])
    posterior = np.repeat([1.0 - LEFT_HANDED_PRIOR, LEFT_HANDED_PRIOR], len(right)) / len(right)
    read = 0
    for f, counted in enumerate(counts):
        if counted is None or not 1 <= counted.count <= 6:
            continue
        reliability = PATTERN_RELIABILITY if counted.is_pattern else OTHER_RELIABILITY
        read += int(counted.is_pattern)
        posterior *= np.where(numberings[:, f] == counted.count, reliability, (1.0 - reliability) / 5.0)
    best = int(np.argmax(posterior))
    probability = float(posterior[best]) / float(posterior.sum())
    shown = ", ".join("?" if c is None else str(c.count) for c in counts)
    if read < FEWEST_COUNTED:
        return _symmetric(len(counts), f"pips were counted on only {read} of its faces (counts: {shown})")
    if probability < LEAST_PROBABILITY:
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
        f"Pips were counted on {read} of 6 faces; the die is {hand} (probability {probability:.3f}).",
    )


def _carried(solid: Solid, turn: Array) -> NDArray[np.int64]:
    """(faces,) index of the face onto which a rotation of the solid takes each face."""
    return np.argmax((solid.normals @ turn.T) @ solid.normals.T, axis=1)


# --- numbers ---


def _read_numbers(solid: Solid, marks: SurfaceMarks) -> FaceNumbers:
    """The numbers on the faces, each if it is clear."""
    count = len(solid.faces)
    patches = {f: patch for f in range(count) if (patch := _figure(marks, f)) is not None}
    if not patches:
        return _symmetric(count, "no face is known well enough to read its number")
    correlation = np.zeros((count, count))
    for f, patch in patches.items():
        correlation[f] = _correlations(patch, count)
    faces, chosen = linear_sum_assignment(-correlation)
    numbers: list[int | None] = [None] * count
    for f, k in zip(faces.tolist(), chosen.tolist(), strict=True):
        margin = correlation[f, k] - np.delete(correlation[f], k).max()
        if correlation[f, k] >= LEAST_CORRELATION and margin >= LEAST_MARGIN:
            numbers[f] = k + 1
    read = sum(n is not None for n in numbers)
    if read == 0:
        return _symmetric(count, "no number is clear enough")
    numbers, inferred = _with_opposites(solid, numbers)
    known = sum(n is not None for n in numbers)
    margins = [
        correlation[f, n - 1] - np.delete(correlation[f], n - 1).max()
        for f, n in enumerate(numbers)
        if n and f in patches
    ]
    probability = float(np.prod([1.0 - DOUBT * np.exp(-max(m, 0.0) / LEAST_MARGIN) for m in margins]))
    rest = "" if known == count else f"; {count - known} are not known, and the numbering of the die stays symmetric"
    return FaceNumbers(tuple(numbers), probability, f"Numbers were read on {read} of {count} faces{inferred}{rest}.")


def _with_opposites(solid: Solid, numbers: list[int | None]) -> tuple[list[int | None], str]:
    """The numbers with those of unread faces from their opposites, if all pairs that were read allow it."""
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


def _figure(marks: SurfaceMarks, face: int) -> Array | None:
    """The marks of a face as a patch (PATCH, PATCH) of ink, centred and scaled; None if there are none."""
    if marks.noise_grey[face] == 0.0:
        return None
    spots = _spots(marks, face)
    if spots is None or not spots.any():
        return None
    texture = marks.texture[face]
    contrast = np.abs(np.where(np.isfinite(texture), texture - np.nanmedian(texture), 0.0))
    # Shading at the border does not belong to the figure.
    near = cv2.dilate(spots.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    # Rows run upwards in face coordinates, downwards in pictures.
    return _patch((contrast * near)[::-1])


def _patch(ink: Array) -> Array | None:
    """An image of ink, centred on its centroid and scaled by its root mean square radius; None if it has less than
    LEAST_RADIUS_TEXELS."""
    total = float(ink.sum())
    if total <= 0.0:
        return None
    rows, columns = np.mgrid[0 : ink.shape[0], 0 : ink.shape[1]]
    y, x = float((ink * rows).sum() / total), float((ink * columns).sum() / total)
    radius = float(np.sqrt((ink * ((rows - y) ** 2 + (columns - x) ** 2)).sum() / total))
    if radius < LEAST_RADIUS_TEXELS:
        return None
    scale = PATCH_RADII * radius / (0.5 * PATCH)
    patch_to_ink = np.array([[scale, 0.0, x - scale * 0.5 * (PATCH - 1)], [0.0, scale, y - scale * 0.5 * (PATCH - 1)]])
    return cv2.warpAffine(ink, patch_to_ink, (PATCH, PATCH), flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP).astype(float)


def _details(patch: Array, blur: float) -> Array:
    """The patch blurred, without its coarse shape (in which figures hardly differ), of zero mean and unit power."""
    soft = cv2.GaussianBlur(patch, (0, 0), blur)
    soft = soft - cv2.GaussianBlur(soft, (0, 0), COARSE_PX)
    soft = soft - soft.mean()
    return np.asarray(soft / np.linalg.norm(soft))


def _correlations(patch: Array, count: int) -> Array:
    """(count,) best correlation of a patch with each number, over fonts, angles, small shifts and sizes, and blurs."""
    details = _details(patch, MIDDLE_BLUR_PX).astype(np.float32)
    shifts = _shifted(_details(patch, BLURS_PX[0]))
    coarse = [(rotated @ details.ravel(), number, drawn) for number, drawn, rotated in _drawn_numbers(count)]
    refined_from = max(float(by_angle.max()) for by_angle, _, _ in coarse) - REFINED_WITHIN
    best = np.full(count, -1.0)
    for by_angle, number, drawn in coarse:
        best[number - 1] = max(best[number - 1], float(by_angle.max()))
        if by_angle.max() > refined_from:
            refined = max(_refined_correlation(drawn, 360.0 * k / ANGLES, shifts) for k in _best_angles(by_angle))
            best[number - 1] = max(best[number - 1], refined)
    return best


def _best_angles(by_angle: NDArray[np.float32]) -> list[int]:
    """The angle of the best correlation, and the best of those more than SECOND_ANGLE_DEG from it."""
    first = int(np.argmax(by_angle))
    distance = np.abs((np.arange(ANGLES) - first + ANGLES // 2) % ANGLES - ANGLES // 2)
    return [first, int(np.argmax(np.where(360.0 * distance > ANGLES * SECOND_ANGLE_DEG, by_angle, -1.0)))]


def _shifted(patch: Array) -> NDArray[np.float32]:
    """(shifts, PATCH²) the patch shifted by up to FINE_SHIFT_PX each way."""
    shifts = range(-FINE_SHIFT_PX, FINE_SHIFT_PX + 1)
    return np.array([np.roll(patch, (i, j), (0, 1)).ravel() for i in shifts for j in shifts], np.float32)


def _rotated(patch: Array, degrees: float, size: float) -> Array:
    """The patch rotated about its middle, and scaled."""
    middle = 0.5 * (PATCH - 1)
    return cv2.warpAffine(patch, cv2.getRotationMatrix2D((middle, middle), degrees, size), (PATCH, PATCH))


def _refined_correlation(drawn: Array, degrees: float, shifts: NDArray[np.float32]) -> float:
    """Best correlation of a drawn number, near one angle, with the shifts of a patch."""
    best = -1.0
    for size in SIZES:
        for angle in FINE_ANGLES_DEG:
            placed = _rotated(drawn, degrees + angle, size)
            for blur in BLURS_PX:
                best = max(best, float((shifts @ _details(placed, blur).astype(np.float32).ravel()).max()))
    return best


@cache
def _drawn_numbers(count: int) -> tuple[tuple[int, Array, NDArray[np.float32]], ...]:
    """Numbers 1 to `count` in all fonts, each as drawn and its details (ANGLES, PATCH²) at all angles.

    Where both 6 and 9 occur, they have a dot or a bar.
    """
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    out = []
    for font in FONTS:
        properties = FontProperties(family=font, weight="bold")
        for number in range(1, count + 1):
            figures = [(f"{number}.", False), (f"{number}", True)]
            if count < 9 or number not in (6, 9):
                figures = [(f"{number}", False)]
            for text, bar in figures:
                path = TextPath((0.0, 0.0), text, 100.0, prop=properties)
                patch = _patch(_ink([np.asarray(p, float) for p in path.to_polygons()], bar))
                assert patch is not None
                angles = 360.0 * np.arange(ANGLES) / ANGLES
                details = [_details(_rotated(patch, float(angle), 1.0), MIDDLE_BLUR_PX).ravel() for angle in angles]
                out.append((number, patch, np.array(details, np.float32)))
    return tuple(out)


def _ink(polygons: list[Array], bar: bool) -> Array:
    """An image of filled outlines with holes, the y axis downwards, and optionally a bar below the figure."""
    points = np.concatenate(polygons)
    low, high = points.min(0) - 30.0, points.max(0) + 30.0
    image = np.zeros((int(high[1] - low[1]), int(high[0] - low[0])), np.uint8)
    outlines = [np.rint((p - low) * [1, -1] + [0, high[1] - low[1]]).astype(np.int32) for p in polygons]
    cv2.fillPoly(image, outlines, 1)
    if bar:
        left, right = (int(v) for v in (points[:, 0].min() - low[0], points[:, 0].max() - low[0]))
        bottom = int(high[1] - points[:, 1].min())
        image[bottom + 8 : bottom + 18, left:right] = 1
    return image.astype(float)
