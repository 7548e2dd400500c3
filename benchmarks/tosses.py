"""Real tosses: single impacts and whole throws foretold, by this model and by MuJoCo tuned on the same tosses.

    python benchmarks/tosses.py DATA [--tosses 360] [--mujoco] [--threads 2]

DATA holds `scene.toml` and `toss_*.csv` (columns of track.csv). Every figure is of tosses that were not in the fit: they
are dealt into two halves, and each is foretold with parameters of the other.

1. First impacts at a single corner, between two flights that both show four frames or more: the state before is carried to
   the touch, one impact is made, and velocity and spin after it are compared with the flight that follows (RMS).
2. Whole throws, from the state before the first bounce to the last frame: mean over throws of the mean over frames, of the
   position in % of the edge and of the rotation, over the frames after the first bounce, and over all frames.

MuJoCo (`pip install mujoco`) gets a box, or a sphere in each corner, with solref, friction, size and inertia tuned by
Nelder and Mead's method with as many throws simulated as the joint fit took.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from diethrow.fitting.crowd import Entry, entry_of
from diethrow.fitting.joint import fit_jointly
from diethrow.fitting.joint_effects import EFFECTS
from diethrow.fitting.outset import outset_before
from diethrow.fitting.physics import Physics
from diethrow.fitting.prediction import simulated_poses
from diethrow.model import kernels
from diethrow.model.bodies import touching_vertices
from diethrow.model.impacts import impulse_N_s
from diethrow.model.motion import GRAVITY_M_S2, Flight, State
from diethrow.model.rotations import rotation_between
from diethrow.model.solids import Die
from diethrow.model.tables import LEVEL
from diethrow.model.touch import Touch
from diethrow.records import read_track
from diethrow.scene import read_scene

Array = NDArray[np.float64]

SPIN_ARM_M = 0.03
"""By which residuals of spin count beside those of velocity: about their ratio."""

CLEAR_M = 0.004
"""Height of the second lowest corner above which an impact is that of one corner alone."""


@dataclass(frozen=True, eq=False)
class FirstImpact:
    """The flights before and after, told from frames on their own side."""

    before: Flight
    after: State


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--tosses", type=int, default=None, help="use only so many, evenly spread")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--mujoco", action="store_true")
    options = parser.parse_args()
    die = read_scene(options.data / "scene.toml").die
    entries = read_entries(options.data, die, options.tosses)
    print(f"{len(entries)} tosses")
    first_impacts(entries, die)
    whole_throws(entries, die, options.threads)
    if options.mujoco:
        mujoco_throws(entries, die)


def read_entries(folder: Path, die: Die, count: int | None) -> list[Entry]:
    """The tosses of a folder."""
    paths = sorted(folder.glob("toss_*.csv"))
    if count is not None:
        paths = [paths[k] for k in np.linspace(0, len(paths) - 1, count).round().astype(int)]
    return [entry_of(path.stem, read_track(path), die) for path in paths]


# --- single impacts ---


def first_impacts(entries: Sequence[Entry], die: Die) -> None:
    """The first table."""
    impacts = [found for entry in entries if (found := first_impact(entry, die)) is not None]
    print(f"\nfirst impacts at one corner: {len(impacts)}\nlaw                              v [m/s]   spin [rad/s]")
    for name, start in (
        ("frictionless", {"chi": 0.27, "inertia_kg_m2": 0.0012}),
        ("Coulomb, integrated (Routh)", {"chi": 0.27, "mu": 0.16, "inertia_kg_m2": 0.00105}),
        ("the same, chi fading", {"chi": 0.3, "mu": 0.16, "inertia_kg_m2": 0.00105, "chi_fade_s_per_m": 0.1}),
        (
            "the same, mu fading too",
            {"chi": 0.3, "mu": 0.2, "inertia_kg_m2": 0.00105, "chi_fade_s_per_m": 0.1, "mu_fade_s_per_m": 0.1},
        ),
    ):
        v, w = cross_validated(impacts, Physics(die, LEVEL, {**start, "corner_radius_m": 0.0036}))
        print(f"{name:<32} {v:7.3f}   {w:7.2f}")


def first_impact(entry: Entry, die: Die) -> FirstImpact | None:
    """The first impact of a toss, if one corner made it and four frames or more tell the flight after it."""
    if not 4 <= entry.early < len(entry.rows):
        return None
    after = outset_before(entry.track, die, int(entry.rows[entry.early]))
    before = Flight(entry.outset.state, entry.outset.state.time_s + 0.02)
    return FirstImpact(before, after.flight.start)


def after_impact(impact: FirstImpact, physics: Physics) -> Array:
    """(6,) velocity and spin that a law foretells, less those seen; NaN where more than one corner may touch."""
    die = physics.body
    state, arm, second = touch(impact.before, die)
    if second < CLEAR_M:
        return np.full(6, np.nan)
    lowered = arm - np.array([0.0, 0.0, die.corner_radius_m])
    impulse = impulse_N_s(die, Touch(state, 0, lowered, np.nan), physics.law)
    velocity = state.velocity_m_s + impulse / die.mass_kg
    spin = state.omega_rad_s + np.cross(lowered, impulse) / die.inertia_kg_m2
    rise = GRAVITY_M_S2 * (impact.after.time_s - state.time_s)
    return np.concatenate(
        [velocity - impact.after.velocity_m_s - [0.0, 0.0, rise], SPIN_ARM_M * (spin - impact.after.omega_rad_s)]
    )


def touch(flight: Flight, die: Die) -> tuple[State, Array, float]:
    """State at the touch, arm (3,) to the corner's centre, and the height of the second lowest corner then."""
    corners = touching_vertices(die)
    time = flight.start.time_s
    for _ in range(30):
        state = flight.at(time)
        turned = corners @ state.rotation.T
        heights = np.sort(turned[:, 2]) + state.position_m[2] - die.corner_radius_m
        arm = turned[int(np.argmin(turned[:, 2]))]
        speed = state.velocity_m_s[2] + state.omega_rad_s[0] * arm[1] - state.omega_rad_s[1] * arm[0]
        if abs(heights[0]) < 1e-9 or speed >= 0.0:
            break
        time -= float(np.clip(heights[0] / speed, -0.004, 0.004))
    return state, arm, float(heights[1])


def cross_validated(impacts: Sequence[FirstImpact], start: Physics) -> tuple[float, float]:
    """RMS of velocity [m/s] and spin [rad/s] residuals over two folds."""
    start = replace(start, held=frozenset({"corner_radius_m"}))
    told = np.array([np.isfinite(after_impact(impact, start)).all() for impact in impacts])
    clean = [impact for impact, kept in zip(impacts, told, strict=True) if kept]
    scale = np.array([start.values[name] for name in start.free])

    def residuals(some: Sequence[FirstImpact], physics: Physics) -> Array:
        return np.array([after_impact(impact, physics) for impact in some])

    left_out = []
    for k in (0, 1):
        mine, others = clean[k::2], clean[1 - k :: 2]

        def cost(u: Array, others: Sequence[FirstImpact] = others) -> Array:
            return residuals(others, start.moved(scale * u)).ravel()

        u = least_squares(cost, np.zeros(len(scale)), diff_step=1e-4, loss="soft_l1", f_scale=0.05, max_nfev=15).x
        left_out.append(residuals(mine, start.moved(scale * u)))
    errors = np.concatenate(left_out)
    v, w = np.sqrt((errors[:, :3] ** 2).sum(1).mean()), np.sqrt((errors[:, 3:] ** 2).sum(1).mean())
    return float(v), float(w / SPIN_ARM_M)


# --- whole throws ---


def whole_throws(entries: Sequence[Entry], die: Die, threads: int) -> None:
    """The second table."""
    print(f"\nwhole throws                    {'after the bounce':>22} {'all frames':>20}   fit [s]")
    for name, effects in (
        ("frictionless", ()),
        ("friction", ("friction",)),
        ("with all effects that pay", tuple(EFFECTS)),
    ):
        errors, seconds = [], 0.0
        for k in (0, 1):
            begin = time.perf_counter()
            fit = fit_jointly(entries[1 - k :: 2], die, threads=threads, effects=effects)
            seconds += time.perf_counter() - begin
            errors += [error_of(entry, die, told(entry, fit.physics)) for entry in entries[k::2]]
        print_errors(name, errors, seconds)
        print("   ", ", ".join(f"{key} {value:.4g}" for key, value in fit.physics.values.items()))


def told(entry: Entry, physics: Physics) -> tuple[Array, Array]:
    return simulated_poses(physics, entry.outset.state, entry.times_s, kernels.FINE)


def error_of(entry: Entry, die: Die, poses: tuple[Array, Array]) -> Array:
    """(4,) mean position error [% of the edge] and rotation error [deg] after the bounce; the same over all frames."""
    edge = float(np.linalg.norm(np.diff(die.solid.vertices[die.solid.edges[0]], axis=0)))
    off = 100.0 * np.linalg.norm(poses[0] - entry.track.position_m[entry.rows], axis=1) / edge
    turned = np.degrees(np.linalg.norm(rotation_between(poses[1], entry.track.quaternion[entry.rows]), axis=1))
    part = len(entry.rows) / (len(entry.rows) + len(entry.outset.rows))
    return np.array([off.mean(), turned.mean(), part * off.mean(), part * turned.mean()])


def print_errors(name: str, errors: Sequence[Array], seconds: float) -> None:
    a, b, c, d = np.mean(errors, axis=0)
    print(f"{name:<32} {a:8.2f} % {b:7.2f} deg {c:8.2f} % {d:7.2f} deg {seconds:8.0f}")


# --- MuJoCo ---

MUJOCO_STARTS: dict[str, Array] = {
    "MuJoCo, a box": np.array([0.004, 0.4, 0.17, 0.0524, 0.001]),
    "MuJoCo, a sphere in each corner": np.array([0.004, 0.4, 0.17, 0.0036, 0.001]),
}
"""Time constant [s] and damping ratio of the contact, friction, half edge or radius [m], inertia [kg m²]."""

MUJOCO_STEP_S = 1e-3
MUJOCO_TRIALS = 120


def mujoco_throws(entries: Sequence[Entry], die: Die) -> None:
    """The same tosses in MuJoCo, each half with what was tuned on the other."""
    for name, start in MUJOCO_STARTS.items():
        errors, seconds = [], 0.0
        for k in (0, 1):
            begin = time.perf_counter()
            tuned = mujoco_tuned(entries[1 - k :: 2], die, start)
            seconds += time.perf_counter() - begin
            errors += mujoco_errors(entries[k::2], die, tuned)
        print_errors(name, errors, seconds)
        print("   ", np.array2string(tuned, precision=4))


def mujoco_tuned(entries: Sequence[Entry], die: Die, start: Array) -> Array:
    """The numbers of least mean error, positions in tenths of an edge and rotations in 13 degrees alike."""

    def cost(u: Array) -> float:
        errors = np.array(mujoco_errors(entries, die, start * np.exp(np.clip(u, -2.0, 2.0))))
        return float((errors[:, 0] / 10.0 + errors[:, 1] / 13.0).mean())

    simplex = np.vstack([np.zeros(len(start)), 0.3 * np.eye(len(start))])
    found = minimize(
        cost, np.zeros(len(start)), method="Nelder-Mead", options={"maxfev": MUJOCO_TRIALS, "initial_simplex": simplex}
    )
    return np.asarray(start * np.exp(np.clip(found.x, -2.0, 2.0)))


def mujoco_errors(entries: Sequence[Entry], die: Die, numbers: Array) -> list[Array]:
    """As `error_of`, of every toss."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mujoco_scene(die, numbers))

    def one(entry: Entry) -> Array:
        data, state = mujoco.MjData(model), entry.outset.state
        data.qpos[:3], data.qpos[3:] = state.position_m, state.quaternion
        # MuJoCo keeps the spin of a free body in its own axes.
        data.qvel[:3], data.qvel[3:] = state.velocity_m_s, state.rotation.T @ state.omega_rad_s
        poses = np.empty((len(entry.rows), 7))
        for k, t in enumerate(entry.times_s - state.time_s):
            while data.time < t - 0.5 * MUJOCO_STEP_S:
                mujoco.mj_step(model, data)
            poses[k] = data.qpos
        return error_of(entry, die, (poses[:, :3], poses[:, 3:]))

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, entries))


def mujoco_scene(die: Die, numbers: Array) -> str:
    """The die on a plane; numbers as in MUJOCO_STARTS."""
    time_s, damping, friction, size_m, inertia = numbers
    half = die.solid.inradius
    contact = f'solref="{time_s} {damping}" friction="{friction} 0.0001 0.0001"'
    if size_m > 0.5 * half:
        shapes = f'<geom type="box" size="{size_m} {size_m} {size_m}" {contact}/>'
    else:
        corners = (half - size_m) * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        shapes = "".join(
            f'<geom type="sphere" size="{size_m}" pos="{x} {y} {z}" {contact}/>' for x, y, z in corners.tolist()
        )
    return f"""<mujoco><option timestep="{MUJOCO_STEP_S}" gravity="0 0 -9.81" cone="elliptic"/><worldbody>
        <geom type="plane" size="5 5 1" {contact}/><body><freejoint/>
        <inertial pos="0 0 0" mass="{die.mass_kg}" diaginertia="{inertia} {inertia} {inertia}"/>{shapes}</body>
        </worldbody></mujoco>"""


if __name__ == "__main__":
    main()
