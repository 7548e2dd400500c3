"""The paper's Fig. 5: two throws, the sequences of corners that hit, and how far such a sequence is determined at all.

The paper names corners by letters without their positions, and does not state how the tetrahedron lies in its body axes. The
letters are therefore assigned to our corners by the best labelling, and every likely placement of the tetrahedron is tried.
The result of chance for the same number of trials is given beside the best one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..model.die import Die, Solid, lowest_face
from ..model.ensembles import CONDITIONS, ThrowSetup, error_growth, states_of
from ..model.laws import SmoothImpact
from ..model.rotations import matrix_from_quat, quat_from_matrix, quat_multiply
from ..model.throw import Impact, State, ThrowResult, Until, throw_die, unpacked_state
from ..model.world import GRAVITY_M_S2
from ..replay.figures import corner_heights
from .results import CHI, Picture, Result, Run, Table, Verdict, cell, cube, drawing, tetrahedron

Array = NDArray[np.float64]

START = {"z0": 0.3, "psi": 0.001, "theta": 0.00001, "phi": 0.0001, "vx": 0.6, "omega_eta": 60.0}
"""Initial conditions of the paper's Fig. 5 [m, rad, m/s, rad/s]."""
SPEEDS_M_S = (-0.7, 0.7)
"""v0z as printed, and upwards."""
STATED = {"tetrahedron": "ABACDABABD", "cube": "CDDCBADBBBB"}
STATED_CHANGES = {"tetrahedron": (4,), "cube": (3, 4, 5, 7)}
"""Impacts after which the lowest face changes, in the paper."""
PERTURBATIONS = tuple(10.0**-k for k in range(15, 1, -1))
"""Relative perturbations of the release."""
OTHER_GRAVITY_M_S2 = (9.8, 9.80665, 10.0)
"""The paper does not state g."""
CHANCE_DRAWS = 4000
SIGNIFICANCE = 0.05
"""Largest probability of an equal agreement by chance at which the agreement counts."""
DECISIVE_ERROR = 0.05
"""Error as a share of the circumradius from which the next corner may be another one."""
MIN_DRAWS = 400
"""Smallest number of draws for the agreement by chance."""
PREFIX_BONUS = 0.01
"""Weight of the first impacts: it decides between labellings with equally many agreements."""


@dataclass(frozen=True)
class Labelling:
    """An assignment of our corners to the paper's letters."""

    matches: int
    """Impacts at which the letters agree, for the labelling with most agreements."""
    prefix: int
    """Number of first impacts that agree under one labelling."""
    letters: str
    """Our corners in the letters of that labelling; a dot for a corner without a letter."""


@dataclass(frozen=True)
class Variant:
    """One interpretation of the paper's initial conditions with the throw that follows."""

    placement: str
    v0z_m_s: float
    vertices: tuple[int, ...]
    labelling: Labelling
    changes: tuple[int, ...]
    """Impacts after which the lowest face half-way through the flight differs from the previous one."""
    changes_at_impacts: tuple[int, ...]
    """The same for the lowest face at the impacts."""
    landed_face: int | None


def best_labelling(stated: str, vertices: Sequence[int]) -> Labelling:
    """Assign a corner to each letter of `stated` so that as many impacts as possible agree (linear assignment).

    All labellings are admissible: on a tetrahedron any of the 24 is a symmetry of the solid, and only four of the eight
    corners of the cube are named. Sequences are compared up to the length of the shorter one.
    """
    letters, corners = sorted(set(stated)), sorted(set(vertices))
    pairs = list(zip(stated, vertices, strict=False))
    agree = np.array([[sum(pair == (a, v) for pair in pairs) for v in corners] for a in letters]).reshape(
        len(letters), len(corners)
    )
    prefix = _prefix(pairs)
    first = dict(pairs[:prefix])
    # Of several labellings with equally many agreements, the one that agrees with the first impacts.
    bonus = np.array([[first.get(a) == v for v in corners] for a in letters]).reshape(agree.shape)
    rows, columns = linear_sum_assignment(-(agree + PREFIX_BONUS * bonus))
    names = {corners[column]: letters[row] for row, column in zip(rows, columns, strict=True)}
    ours = "".join(names.get(v, "·") for v in vertices[: len(stated)])
    return Labelling(int(agree[rows, columns].sum()), prefix, ours)


def _prefix(pairs: Sequence[tuple[str, int]]) -> int:
    """Number of first pairs that agree under one labelling."""
    name_of: dict[int, str] = {}
    corner_of: dict[str, int] = {}
    for k, (letter, corner) in enumerate(pairs):
        if name_of.setdefault(corner, letter) != letter or corner_of.setdefault(letter, corner) != corner:
            return k
    return len(pairs)


def fig_5(run: Run) -> tuple[Result, ...]:
    """The results for both throws, with v0z as printed and upwards."""
    results = []
    for k, die in enumerate((tetrahedron(), cube())):
        results.append(_fig_5_of(run, die))
        run.progress("Fig. 5", k + 1, 2)
    return tuple(results)


def _fig_5_of(run: Run, die: Die) -> Result:
    shape = die.solid.name
    stated = STATED[shape]
    variants = [
        followed(die, name, turn, speed) for name, turn in placements(die.solid).items() for speed in SPEEDS_M_S
    ]
    best = max(variants, key=lambda v: (v.labelling.prefix, v.labelling.matches))
    printed = max(
        (v for v in variants if v.v0z_m_s == SPEEDS_M_S[0]), key=lambda v: (v.labelling.prefix, v.labelling.matches)
    )
    chance = by_chance(stated, len(die.solid.vertices), len(variants), run.seed)
    luck = float(np.mean(chance[:, 0] >= best.labelling.prefix))
    shadows = [_decided(die, v, run) for v in (printed, best)[: 1 if best is printed else 2]]
    table = shadow_table(shadows)
    verdict, why = _judged(stated, printed, best, luck, chance, len(variants))
    picture = _draw(run, die, [v for v in variants if v.placement == best.placement])
    return Result(
        key=f"fig_5_{shape}",
        title=f"Fig. 5: the throw of a {shape}",
        stated=f"The corners that hit are {', '.join(stated)}; the lowest face changes after impact "
        f"{', '.join(map(str, STATED_CHANGES[shape]))}.",
        ours=_summary(printed, "As printed (v0z = −0.7 m/s)")
        + " "
        + _summary(best, f"Best of {len(variants)} interpretations"),
        verdict=verdict,
        why=f"{why} {_limits(shadows)}",
        tables=(_variant_table(variants), table, _gravity_table(die, best)),
        pictures=(picture,),
        numbers={
            "stated": stated,
            "stated_changes": STATED_CHANGES[shape],
            "variants": [_plain(v) for v in variants],
            "chance": {
                "readings": len(variants),
                "draws": CHANCE_DRAWS,
                "mean_matches": float(chance[:, 1].mean()),
                "matches_95": float(np.quantile(chance[:, 1], 0.95)),
                "probability_of_best_prefix": luck,
            },
            "sensitivity": shadows,
        },
    )


def placements(solid: Solid) -> dict[str, Array]:
    """The likely orientations of the die in the paper's body axes: quaternions (4,) from our body axes to those.

    The cube has its faces perpendicular to the axes; all such orientations are equivalent by symmetry. The tetrahedron has
    many orientations.
    """
    none = np.array([1.0, 0.0, 0.0, 0.0])
    if solid.name != "tetrahedron":
        return {"faces square to the axes": none}
    found = {"edges across the axes": none, "the same, turned by 90°": quat_from_matrix(_about_z(0.5 * np.pi))}
    for way, up in (("apex up", 1.0), ("apex down", -1.0)):
        for name, angle in (("+ξ", 0.0), ("+η", 0.5 * np.pi), ("−ξ", np.pi), ("−η", 1.5 * np.pi)):
            found[f"{way}, a corner towards {name}"] = quat_from_matrix(_about_z(angle) @ _standing(solid, up))
    return found


def _standing(solid: Solid, up: float) -> Array:
    """The rotation (3, 3) that puts corner 0 on the ±z axis and corner 1 into the x-z plane, at x > 0."""
    z = up * solid.vertices[0] / np.linalg.norm(solid.vertices[0])
    x = solid.vertices[1] - (solid.vertices[1] @ z) * z
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def released(turn: Array, v0z_m_s: float, factors: Array | None = None, gravity_m_s2: float = GRAVITY_M_S2) -> State:
    """The paper's initial state with the orientation `turn` of the die in its axes; conditions times `factors` (10,).

    Another gravity g' corresponds to speeds and spins times √(g/g'): the path is the same, at another rate.
    """
    given = START | {"vz": v0z_m_s}
    numbers = np.array([given.get(name, 0.0) for name in CONDITIONS])
    if factors is not None:
        numbers = numbers * factors
    numbers[4:] *= sqrt(GRAVITY_M_S2 / gravity_m_s2)
    state = states_of(numbers[None])[0]
    state[3:7] = quat_multiply(state[3:7], turn)
    return unpacked_state(state, 0.0)


def followed(die: Die, placement: str, turn: Array, v0z_m_s: float) -> Variant:
    """The throw of one interpretation, compared with the paper's."""
    result = throw_die(die, released(turn, v0z_m_s), SmoothImpact(CHI))
    vertices = corners_hit(result)
    return Variant(
        placement,
        v0z_m_s,
        vertices,
        best_labelling(STATED[die.solid.name], vertices),
        face_changes(result.throw.bounces),
        face_changes_at_impacts(die, result),
        result.landed_face,
    )


def corners_hit(result: ThrowResult) -> tuple[int, ...]:
    """Our corners in the order of their impacts."""
    return tuple(impact.vertices[0] for impact in result.throw.bounces)


def face_changes(bounces: Sequence[Impact]) -> tuple[int, ...]:
    """Numbers of the impacts after which the lowest face half-way through the flight is another one."""
    return tuple(k for k, impact in enumerate(bounces, 1) if impact.lowest_face_before != impact.lowest_face_after)


def face_changes_at_impacts(die: Die, result: ThrowResult) -> tuple[int, ...]:
    """Numbers of the impacts after which the lowest face at the next impact, or at the end, is another one."""
    states = [result.throw.at(impact.time_s) for impact in result.throw.bounces] + [result.end]
    faces = [lowest_face(die.solid, matrix_from_quat(state.quaternion)) for state in states]
    return tuple(k for k in range(1, len(faces)) if faces[k] != faces[k - 1])


def by_chance(stated: str, corners: int, readings: int, seed: int) -> NDArray[np.int64]:
    """(draws, 2) best prefix and best number of matches among `readings` random sequences of corners."""
    random = np.random.default_rng(seed)
    draws = random.integers(0, corners, (max(CHANCE_DRAWS // readings, MIN_DRAWS), readings, len(stated)))
    best = []
    for draw in draws:
        labellings = [best_labelling(stated, row.tolist()) for row in draw]
        best.append((max(each.prefix for each in labellings), max(each.matches for each in labellings)))
    return np.array(best)


def _decided(die: Die, variant: Variant, run: Run) -> dict[str, Any]:
    """The number of impacts that do not change if the release is perturbed, and the growth of errors."""
    turn = placements(die.solid)[variant.placement]
    until = min(len(STATED[die.solid.name]), len(variant.vertices))
    random = np.random.default_rng(run.seed)
    rows = []
    for size in PERTURBATIONS:
        common = [
            _common(die, turn, variant, 1.0 + size * random.normal(size=len(CONDITIONS)), until)
            for _ in range(run.effort.shadows)
        ]
        rows.append({"disturbance": size, "least": int(min(common)), "median": float(np.median(common))})
    grown = error_growth(ThrowSetup(die, SmoothImpact(CHI)), released(turn, variant.v0z_m_s), impacts=until).at_impacts
    return {
        "placement": variant.placement,
        "v0z_m_s": variant.v0z_m_s,
        "impacts": until,
        "disturbed": rows,
        "log10_growth": grown,
        "decided_by_double": int(np.sum(grown < -np.log10(2.2e-16) + np.log10(DECISIVE_ERROR))),
    }


def _common(die: Die, turn: Array, variant: Variant, factors: Array, until: int) -> int:
    """Number of first impacts that a perturbed throw has in common with the unperturbed one."""
    result = throw_die(die, released(turn, variant.v0z_m_s, factors), SmoothImpact(CHI), until=Until(impacts=until))
    pairs = zip(corners_hit(result), variant.vertices[:until], strict=False)
    return int(np.logical_and.accumulate([a == b for a, b in pairs]).sum())


def _judged(
    stated: str, printed: Variant, best: Variant, luck: float, chance: NDArray[np.int64], readings: int
) -> tuple[Verdict, str]:
    if printed.labelling.prefix == len(stated):
        return Verdict.REPRODUCED, "Every impact agrees, from the initial conditions as printed."
    usual = f"{cell(float(chance[:, 1].mean()))} impacts of {len(stated)} would agree by chance"
    if luck > SIGNIFICANCE:
        return (
            Verdict.NOT_DECIDABLE if readings > 2 else Verdict.NOT_REPRODUCED,
            f"No interpretation agrees better than chance ({usual}, in the best of {readings} interpretations)."
            + (" The paper does not state how the die lies in its body axes." if readings > 2 else ""),
        )
    sign = "with v0z upwards" if best.v0z_m_s > 0 else "with v0z as printed"
    return (
        Verdict.NOT_REPRODUCED,
        f"As printed, the first {printed.labelling.prefix} impacts agree. {sign.capitalize()} the first "
        f"{best.labelling.prefix} do (by chance: p = {cell(luck)}); those that follow do not.",
    )


def _limits(shadows: Sequence[dict[str, Any]]) -> str:
    """How many impacts the initial conditions determine."""
    sentences = []
    for each in shadows:
        least = {row["disturbance"]: row["least"] for row in each["disturbed"]}
        sentences.append(
            f"v0z = {cell(each['v0z_m_s'])} m/s: double precision decides {each['decided_by_double']} of the first "
            f"{each['impacts']} impacts. Initial conditions, or a solution, with a relative error of 10⁻⁶ decide "
            f"{least[PERTURBATIONS[9]]}, of 10⁻³ {least[PERTURBATIONS[12]]}."
        )
    return " ".join(sentences)


def _summary(variant: Variant, head: str) -> str:
    changes = ", ".join(map(str, variant.changes)) or "none"
    return (
        f"{head}: {variant.labelling.letters}, {variant.labelling.prefix} first impacts agree, "
        f"{variant.labelling.matches} in all; the lowest face changes after {changes}."
    )


def _variant_table(variants: Sequence[Variant]) -> Table:
    rows = [
        (
            v.placement,
            v.v0z_m_s,
            v.labelling.letters,
            v.labelling.prefix,
            v.labelling.matches,
            len(v.vertices),
            ", ".join(map(str, v.changes)) or "none",
            ", ".join(map(str, v.changes_at_impacts)) or "none",
        )
        for v in variants
    ]
    return Table(
        "All interpretations that were tried. A dot is a corner without a letter in the best labelling. The lowest face is "
        "taken half-way through each flight, and at the impacts.",
        (
            "the die in its body axes",
            "v0z [m/s]",
            "corners",
            "first impacts that agree",
            "agree in all",
            "impacts to rest",
            "face changes after (half-way)",
            "face changes after (at impacts)",
        ),
        tuple(rows),
    )


def shadow_table(shadows: Sequence[dict[str, Any]]) -> Table:
    """Number of first impacts that a perturbation does not change, by its size."""
    rows = [
        (
            f"10^{round(np.log10(size))}",
            *(value for each in shadows for value in (each["disturbed"][k]["least"], each["disturbed"][k]["median"])),
        )
        for k, size in enumerate(PERTURBATIONS)
    ]
    heads = [f"v0z = {cell(each['v0z_m_s'])} m/s, {what}" for each in shadows for what in ("least", "median")]
    return Table(
        "Number of first impacts that do not change if every initial condition has this relative perturbation: minimum and "
        f"median of the perturbed throws, of {shadows[0]['impacts']} impacts.",
        ("perturbation", *heads),
        tuple(rows),
    )


def _gravity_table(die: Die, best: Variant) -> Table:
    """The best interpretation with other values of g."""
    rows = []
    turn, stated = placements(die.solid)[best.placement], STATED[die.solid.name]
    for gravity in (GRAVITY_M_S2, *OTHER_GRAVITY_M_S2):
        until = Until(impacts=len(stated))
        release = released(turn, best.v0z_m_s, gravity_m_s2=gravity)
        labelling = best_labelling(stated, corners_hit(throw_die(die, release, SmoothImpact(CHI), until=until)))
        rows.append((gravity, labelling.letters, labelling.prefix, labelling.matches))
    return Table(
        f"The paper does not state g. The best interpretation (v0z = {cell(best.v0z_m_s)} m/s) with other values of g.",
        ("g [m/s²]", "corners", "first impacts that agree", "agree in all"),
        tuple(rows),
    )


def _draw(run: Run, die: Die, variants: Sequence[Variant]) -> Picture:
    """Heights of all corners, one panel for each v0z."""
    figure = drawing((8.4, 3.0 * len(variants)))
    for ax, variant in zip(figure.subplots(len(variants), 1, squeeze=False)[:, 0], variants, strict=True):
        release = released(placements(die.solid)[variant.placement], variant.v0z_m_s)
        until = Until(impacts=len(STATED[die.solid.name]) + 1)
        throw = throw_die(die, release, SmoothImpact(CHI), until=until).throw
        times = np.linspace(0.0, throw.bounces[-1].time_s, 3000)
        corner_heights(ax, die.solid, times, *throw.poses(times), impacts=throw.bounces)
        ax.set_title(f"v0z = {cell(variant.v0z_m_s)} m/s, {variant.placement}", loc="left", fontsize=9)
    file = f"fig_5_{die.solid.name}.png"
    figure.savefig(run.folder / file)
    return Picture(file, f"Height of every corner of the {die.solid.name}. Dashed: the impacts.")


def _plain(variant: Variant) -> dict[str, Any]:
    return {
        "placement": variant.placement,
        "v0z_m_s": variant.v0z_m_s,
        "vertices": variant.vertices,
        "letters": variant.labelling.letters,
        "agree_from_first": variant.labelling.prefix,
        "agree": variant.labelling.matches,
        "changes_half_way": variant.changes,
        "changes_at_impacts": variant.changes_at_impacts,
        "landed_face": variant.landed_face,
    }
