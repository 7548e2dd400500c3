"""The ground truth of a rendered clip, in the columns that `benchmarks/accuracy.py` reads.

SI units, world axes. `truth.csv` has a row for every frame, at mid-exposure. `bounces.csv` has a row for every impact, with the
motion just before and just after it. `truth.toml` has the law and the release, `vertices.csv` and `faces.csv` the body frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...files.csv_and_json import write_table
from ...model.die import Die
from ...model.laws import CoulombImpact, SmoothImpact
from ...model.rotations import continuous_sign
from ...model.throw import Impact, State, Throw
from ...tracking.camera import Camera

Array = NDArray[np.float64]

MOTION = ("vx", "vy", "vz", "wx", "wy", "wz")
POSE = ("frame", "t", "x", "y", "z", "qw", "qx", "qy", "qz", *MOTION, "fully_visible", "in_view")
BOUNCE = (
    *("t", "vertex", "ax", "ay", "az", "vn_pre", "vn_post", "chi", "mu", "Px", "Py", "Pz"),
    *(f"{name}_pre" for name in MOTION),
    *(f"{name}_post" for name in MOTION),
)


def write_truth(
    folder: Path,
    throw: Throw,
    die: Die,
    camera: Camera,
    law: SmoothImpact | CoulombImpact,
    fps: float,
    frames: int,
    times_s: Array | None = None,
) -> None:
    """Write all files of the truth, for frames 0 to `frames` - 1 at k / fps.

    Where the order of frames has faults, `times_s` (frames,) are the true times of the pictures that they show.
    """
    times = np.arange(frames) / fps if times_s is None else times_s
    write_table(folder / "truth.csv", POSE, _poses(throw, die, camera, times))
    shown = [impact for impact in throw.bounces if impact.time_s <= times[-1]]
    write_table(folder / "bounces.csv", BOUNCE, (_bounce(throw, impact, law) for impact in shown))
    corners = die.solid.vertices
    write_table(
        folder / "vertices.csv", ("vertex", "x", "y", "z"), ((k, *row) for k, row in enumerate(corners.tolist()))
    )
    faces = zip(die.solid.normals.tolist(), die.solid.faces, strict=True)
    rows = ((k + 1, *normal, " ".join(map(str, face))) for k, (normal, face) in enumerate(faces))
    write_table(folder / "faces.csv", ("number", "nx", "ny", "nz", "vertices_ccw_outside"), rows)
    (folder / "truth.toml").write_text(_law_text(throw, die, camera, law, fps, len(shown)), encoding="utf-8")


def visibility(die: Die, camera: Camera, positions_m: Array, rotations: Array) -> tuple[NDArray[np.bool_], ...]:
    """(n,) whether the whole die lies within the picture, and whether any of it does; occluders do not count."""
    corners = np.einsum("nij,vj->nvi", rotations, die.solid.vertices) + positions_m[:, None]
    corners_px = camera.project(corners)
    with np.errstate(invalid="ignore"):
        low, high = corners_px.min(1), corners_px.max(1)
        size = np.array([camera.width_px, camera.height_px])
        whole = (low >= 0).all(1) & (high <= size - 1).all(1)
        part = (high >= -0.5).all(1) & (low <= size - 0.5).all(1)
    return whole, part


def _poses(throw: Throw, die: Die, camera: Camera, times_s: Array) -> Iterable[Sequence[Any]]:
    states = [throw.at(float(t)) for t in times_s]
    quaternions = continuous_sign(np.array([state.quaternion for state in states]))
    positions = np.array([state.position_m for state in states])
    rotations = np.array([state.rotation for state in states])
    whole, part = visibility(die, camera, positions, rotations)
    for k, state in enumerate(states):
        numbers = (*positions[k].tolist(), *quaternions[k].tolist(), *_motion(state))
        yield (k, float(times_s[k]), *numbers, int(whole[k]), int(part[k]))


def _bounce(throw: Throw, impact: Impact, law: SmoothImpact | CoulombImpact) -> Sequence[Any]:
    before = next(k for k, other in enumerate(throw.impacts) if other is impact)
    pre, post = (throw.flights[k].at(impact.time_s) for k in (before, before + 1))
    return (
        impact.time_s,
        " ".join(map(str, impact.vertices)),
        *impact.point_m.tolist(),
        0.0,
        impact.normal_velocity_before_m_s,
        impact.normal_velocity_after_m_s,
        law.chi,
        getattr(law, "mu", 0.0),
        *impact.impulse_N_s.tolist(),
        *_motion(pre),
        *_motion(post),
    )


def _motion(state: State) -> tuple[float, ...]:
    return (*state.velocity_m_s.tolist(), *state.omega_rad_s.tolist())


def _law_text(
    throw: Throw, die: Die, camera: Camera, law: SmoothImpact | CoulombImpact, fps: float, bounces: int
) -> str:
    release = throw.flights[0].start
    friction = f"Coulomb, {law.restitution} restitution" if isinstance(law, CoulombImpact) else "none"
    contact = "sphere of corner_radius_m about the inset corner" if die.corner_radius_m else "sharp corner"
    return f"""[clip]
fps = {fps!r}

[camera]
rotation = {camera.rotation.tolist()}

[truth]
chi = {law.chi!r}
mu = {getattr(law, "mu", 0.0)!r}
friction_model = "{friction}"
contact = "{contact}"
drag_per_m = {getattr(throw.flights[0], "drag_per_m", 0.0)!r}
c0 = {release.position_m.tolist()}
v0 = {release.velocity_m_s.tolist()}
q0_wxyz_body_to_world = {release.quaternion.tolist()}
omega0_world = {release.omega_rad_s.tolist()}
bounces = {bounces}
"""
