"""Real tosses: single impacts and whole throws, predicted by this model and by MuJoCo tuned on the same tosses.

    python benchmarks/tosses.py DATA [--tosses 360] [--folds 2] [--parts impacts throws mujoco] [--threads 2]

DATA holds `scene.toml` and `toss_*.csv` (columns of track.csv). Every figure is of tosses that were not in the fit: they
are divided into folds, and each fold is predicted with what was fitted to the others.

1. First impacts at a single corner, between two flights that both have four frames or more. The state before is carried to
   the touch and one impact is made. Velocity of the centre of mass and spin after it are compared with the next flight:
   root mean square, and median, since a second corner that strikes between two frames spoils some impacts.
2. Whole throws, from the release state before the first bounce to the last frame: means over throws of the mean over frames
   of the position error in % of the edge and of the rotation error, after the first bounce and over all frames.
3. The errors of the last of these throws by the time since the first bounce.

MuJoCo (`pip install mujoco`) gets a box, or a sphere in each corner, with solref, friction, size and inertia tuned by
Nelder and Mead's method; then the spheres once more with the centre of mass that the flights show.
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

from diethrow.files.scene import read_scene
from diethrow.files.throw_records import read_track
from diethrow.fitting.dataset.data_set import Entry, entry_of
from diethrow.fitting.dataset.flight_evidence import offset_from_flights
from diethrow.fitting.dataset.joint_effects import EFFECTS
from diethrow.fitting.dataset.joint_fit import fit_jointly
from diethrow.fitting.predict.prediction import simulated_poses
from diethrow.fitting.predict.release_state import ReleaseState, release_from
from diethrow.fitting.throw.physics import CENTRE_OF_MASS, Physics
from diethrow.model import engine
from diethrow.model.die.die import Die
from diethrow.model.laws import LEVEL
from diethrow.model.rotations import angle_between
from diethrow.model.throw.body import body_of
from diethrow.model.throw.motion import Flight, State
from diethrow.model.throw.touch import Touch, impulse_N_s
from diethrow.model.world import GRAVITY_M_S2

Array = NDArray[np.float64]

SPIN_ARM_M = 0.03
"""Weight [m] of residuals of spin beside those of velocity: about their ratio."""

CLEAR_M = 0.004
"""Height of the second lowest corner above which an impact is that of one corner alone."""


SAME_PLACE_M = 1e-3
"""Distance within which the flights before and after meet at a single impact: several times their errors."""

SAME_TURN_RAD = 0.01
"""The same of their orientations."""

MIN_FRAMES_AFTER = 4
"""Frames of the flight after an impact."""

PARTS = ("impacts", "throws", "mujoco")


@dataclass(frozen=True, eq=False)
class FirstImpact:
    """The flights before and after, each from the frames on its own side."""

    before: ReleaseState
    after: ReleaseState


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--tosses", type=int, default=None, help="use only so many, evenly spread")
    parser.add_argument("--folds", type=int, default=2)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS[:2])
    options = parser.parse_args()
    die = read_scene(options.data / "scene.toml").die
    entries = read_entries(options.data, die, options.tosses)
    print(f"{len(entries)} tosses")
    if "impacts" in options.parts:
        first_impacts(entries, die, options.folds)
    if "throws" in options.parts:
        fits = whole_throws(entries, die, options.folds, options.threads)
        errors_by_time(entries, fits)
    if "mujoco" in options.parts:
        mujoco_throws(entries, die, options.folds)


def read_entries(folder: Path, die: Die, count: int | None) -> list[Entry]:
    """The tosses of a folder."""
    paths = sorted(folder.glob("toss_*.csv"))
    if count is not None:
        paths = [paths[k] for k in np.linspace(0, len(paths) - 1, count).round().astype(int)]
    return [entry_of(path.stem, read_track(path), die) for path in paths]


# --- single impacts ---


LAWS: dict[str, dict[str, float]] = {
    "frictionless": {"chi": 0.27, "inertia_kg_m2": 0.0012, "corner_radius_m": 0.0045},
    "Coulomb, integrated (Routh)": {"chi": 0.27, "mu": 0.16, "inertia_kg_m2": 0.00107, "corner_radius_m": 0.0045},
    "the same, loaded": {
        "chi": 0.25,
        "mu": 0.16,
        "inertia_kg_m2": 0.001,
        "corner_radius_m": 0.006,
        **dict(zip(CENTRE_OF_MASS, (0.0001, 0.0001, 0.004), strict=True)),
    },
}
"""Laws of single impacts, and where their fits begin."""


def first_impacts(entries: Sequence[Entry], die: Die, folds: int) -> None:
    """The first table."""
    impacts = [found for entry in entries if (found := first_impact(entry)) is not None]
    reference = Physics(die, LEVEL, LAWS["Coulomb, integrated (Routh)"])
    single = [impact for impact in impacts if is_single_corner(impact, reference)]
    print(f"\nfirst impacts at one corner: {len(single)}")
    print("law                              v [m/s] rms, median   spin [rad/s] rms, median")
    fading = {"chi_fade_s_per_m": 0.1}
    for name, start in {**LAWS, "the same, chi fading": {**LAWS["the same, loaded"], **fading}}.items():
        errors = cross_validated(single, Physics(die, LEVEL, start), folds)
        v, w = np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1) / SPIN_ARM_M
        print(
            f"{name:<32} {np.sqrt((v**2).mean()):7.3f} {np.median(v):7.3f}"
            f"          {np.sqrt((w**2).mean()):7.2f} {np.median(w):7.2f}",
            flush=True,
        )


def first_impact(entry: Entry) -> FirstImpact | None:
    """The first impact of a toss, if the flight after it has four frames or more."""
    if not MIN_FRAMES_AFTER <= entry.early < len(entry.rows):
        return None
    after = release_from(entry.track, entry.rows[: entry.early])
    return FirstImpact(entry.release, after) if after.has_residuals_like(entry.release) else None


def after_impact(impact: FirstImpact, physics: Physics) -> Array:
    """(6,) predicted minus observed velocity of the centre of mass and spin."""
    state, arm, _ = touch(impact, physics)
    fair = replace(
        physics, values={name: value for name, value in physics.values.items() if name not in CENTRE_OF_MASS}
    ).body
    impulse = impulse_N_s(fair, Touch(state, 0, arm, np.nan), physics.law)
    velocity = state.velocity_m_s + impulse / fair.mass_kg
    spin = state.omega_rad_s + np.cross(arm, impulse) / fair.inertia_kg_m2
    after = impact.after.of_die(physics.body).centre_state
    fall = np.array([0.0, 0.0, GRAVITY_M_S2 * (after.time_s - state.time_s)])
    return np.concatenate([velocity - after.velocity_m_s - fall, SPIN_ARM_M * (spin - after.omega_rad_s)])


def is_single_corner(impact: FirstImpact, physics: Physics) -> bool:
    """Whether no other corner is near the table at the touch and both flights agree on the pose then. If a second corner
    strikes before the next frames, the later flight leads back to another pose."""
    state, _, clearance_m = touch(impact, physics)
    after = impact.after.fair_state
    positions, quaternions = Flight(after, after.time_s).poses([state.time_s])
    off = float(np.linalg.norm(positions[0] - state.position_m))
    turned = float(angle_between(quaternions[0], state.quaternion))
    return clearance_m > CLEAR_M and off < SAME_PLACE_M and turned < SAME_TURN_RAD


def touch(impact: FirstImpact, physics: Physics) -> tuple[State, Array, float]:
    """State of the centre of mass at the touch, arm (3,) to the contact, height of the second lowest corner then."""
    body = body_of(physics.body)
    begin = impact.before.of_die(physics.body).centre_state
    flight, time = Flight(begin, begin.time_s + 0.02), begin.time_s
    for _ in range(30):
        state = flight.at(time)
        turned = body.vertices @ state.rotation.T
        heights = np.sort(turned[:, 2]) + state.position_m[2] - body.corner_radius
        arm = turned[int(np.argmin(turned[:, 2]))]
        speed = state.velocity_m_s[2] + state.omega_rad_s[0] * arm[1] - state.omega_rad_s[1] * arm[0]
        if abs(heights[0]) < 1e-9 or speed >= 0.0:
            break
        time -= float(np.clip(heights[0] / speed, -0.004, 0.004))
    return state, arm - np.array([0.0, 0.0, body.corner_radius]), float(heights[1])


def cross_validated(impacts: Sequence[FirstImpact], start: Physics, folds: int) -> Array:
    """(n, 6) residuals of each fold, with parameters fitted to the others."""
    scale = np.array([max(abs(start.values[name]), 1e-3) for name in start.free])

    def residuals(some: Sequence[FirstImpact], physics: Physics) -> Array:
        return np.array([after_impact(impact, physics) for impact in some])

    left_out = []
    for k in range(folds):
        mine = list(impacts[k::folds])
        others = [impact for j in range(folds) if j != k for impact in impacts[j::folds]]

        def cost(u: Array, others: Sequence[FirstImpact] = others) -> Array:
            return residuals(others, start.moved(scale * u)).ravel()

        u = least_squares(cost, np.zeros(len(scale)), diff_step=1e-4, loss="soft_l1", f_scale=0.03, max_nfev=15).x
        left_out.append(residuals(mine, start.moved(scale * u)))
    return np.concatenate(left_out)


# --- whole throws ---


HEADING = f"\nwhole throws                    {'after the bounce':>22} {'all frames':>20}   fit [s]"


def whole_throws(entries: Sequence[Entry], die: Die, folds: int, threads: int) -> list[Physics]:
    """The second table; returns the last of its laws for each fold."""
    print(HEADING)
    fair = tuple(effect for effect in EFFECTS if effect != "loaded die")
    for name, effects in (
        ("frictionless", ()),
        ("all effects but a loaded die", fair),
        ("with all accepted effects", tuple(EFFECTS)),
    ):
        errors, seconds, fits = [], 0.0, []
        for k in range(folds):
            begin = time.perf_counter()
            fits.append(fit_jointly(others(entries, k, folds), die, threads=threads, effects=effects).physics)
            seconds += time.perf_counter() - begin
            errors += [error_of(entry, die, predicted_poses(entry, fits[k])) for entry in entries[k::folds]]
        print_errors(name, errors, seconds / folds)
        for physics in fits:
            print("   ", ", ".join(f"{key} {value:.4g}" for key, value in physics.values.items()), flush=True)
    return fits


def others(entries: Sequence[Entry], k: int, folds: int) -> list[Entry]:
    """The tosses of all folds but one."""
    return [entry for j in range(folds) if j != k for entry in entries[j::folds]]


def predicted_poses(entry: Entry, physics: Physics) -> tuple[Array, Array]:
    """Poses of a toss from its release state, at the finest precision."""
    return simulated_poses(physics, entry.release.of_die(physics.body).state, entry.times_s, engine.FINE)


TIMES_S = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, np.inf)


def errors_by_time(entries: Sequence[Entry], fits: Sequence[Physics]) -> None:
    """The third table: median over throws."""
    print("\ntime since the first bounce [s]   position [mm]   along travel   turn [deg]")
    rows: list[list[Array]] = [[] for _ in TIMES_S[1:]]
    for k, entry in enumerate(entries):
        poses = predicted_poses(entry, fits[k % len(fits)])
        off = poses[0] - entry.track.position_m[entry.rows]
        turned = angle_between(poses[1], entry.track.quaternion[entry.rows])
        travel = entry.track.position_m[entry.rows[-1], :2] - entry.release.state.position_m[:2]
        along = off[:, :2] @ (travel / np.linalg.norm(travel))
        since = entry.times_s - entry.times_s[0]
        for row, low, high in zip(rows, TIMES_S, TIMES_S[1:], strict=False):
            which = (since >= low) & (since < high)
            if which.any():
                values = (np.linalg.norm(off[which], axis=1), along[which], turned[which])
                row.append(np.array([value.mean() for value in values]))
    for row, low, high in zip(rows, TIMES_S, TIMES_S[1:], strict=False):
        if row:
            far, along_m, turn = np.median(row, axis=0) * [1e3, 1e3, 180.0 / np.pi]
            print(f"{low:>10.2f} to {high:<19.2f} {far:>10.1f} {along_m:>14.1f} {turn:>12.1f}")


def error_of(entry: Entry, die: Die, poses: tuple[Array, Array]) -> Array:
    """(4,) mean position error [% of the edge] and rotation error [deg] after the bounce; the same over all frames."""
    edge = float(np.linalg.norm(np.diff(die.solid.vertices[die.solid.edges[0]], axis=0)))
    off = 100.0 * np.linalg.norm(poses[0] - entry.track.position_m[entry.rows], axis=1) / edge
    turned = np.degrees(angle_between(poses[1], entry.track.quaternion[entry.rows]))
    part = len(entry.rows) / (len(entry.rows) + len(entry.release.rows))
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


def mujoco_throws(entries: Sequence[Entry], die: Die, folds: int) -> None:
    """The same tosses in MuJoCo, each fold with numbers tuned on the others and the centre of mass of their flights."""
    print(HEADING)
    spheres = MUJOCO_STARTS["MuJoCo, a sphere in each corner"]
    for name, start in {**MUJOCO_STARTS, "the same, loaded": spheres}.items():
        errors, seconds = [], 0.0
        for k in range(folds):
            rest = others(entries, k, folds)
            load = (
                offset_from_flights(rest, Physics(die, LEVEL, {"chi": 0.5})).values
                if name.startswith("the same")
                else None
            )
            begin = time.perf_counter()
            tuned = mujoco_tuned(rest, die, start, load)
            seconds += time.perf_counter() - begin
            errors += mujoco_errors(entries[k::folds], die, tuned, load)
        print_errors(name, errors, seconds / folds)
        print("   ", np.array2string(tuned, precision=4), flush=True)


def mujoco_tuned(entries: Sequence[Entry], die: Die, start: Array, load_m: Array | None) -> Array:
    """The numbers of least mean error, with 10 % of an edge weighted as 13 degrees."""

    def cost(u: Array) -> float:
        errors = np.array(mujoco_errors(entries, die, start * np.exp(np.clip(u, -2.0, 2.0)), load_m))
        return float((errors[:, 0] / 10.0 + errors[:, 1] / 13.0).mean())

    simplex = np.vstack([np.zeros(len(start)), 0.3 * np.eye(len(start))])
    found = minimize(
        cost, np.zeros(len(start)), method="Nelder-Mead", options={"maxfev": MUJOCO_TRIALS, "initial_simplex": simplex}
    )
    return np.asarray(start * np.exp(np.clip(found.x, -2.0, 2.0)))


def mujoco_errors(entries: Sequence[Entry], die: Die, numbers: Array, load_m: Array | None) -> list[Array]:
    """As `error_of`, of every toss."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mujoco_scene(die, numbers, load_m))
    loaded = die if load_m is None else replace(die, centre_of_mass_m=load_m)

    def one(entry: Entry) -> Array:
        data, state = mujoco.MjData(model), entry.release.of_die(loaded).state
        data.qpos[:3], data.qpos[3:] = state.position_m, state.quaternion
        # In MuJoCo the spin of a free body is in body axes.
        data.qvel[:3], data.qvel[3:] = state.velocity_m_s, state.rotation.T @ state.omega_rad_s
        poses = np.empty((len(entry.rows), 7))
        for k, t in enumerate(entry.times_s - state.time_s):
            while data.time < t - 0.5 * MUJOCO_STEP_S:
                mujoco.mj_step(model, data)
            poses[k] = data.qpos
        return error_of(entry, die, (poses[:, :3], poses[:, 3:]))

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, entries))


def mujoco_scene(die: Die, numbers: Array, load_m: Array | None) -> str:
    """The die on a plane; numbers as in MUJOCO_STARTS."""
    time_s, damping, friction, size_m, inertia = numbers
    half = die.solid.inradius
    place = " ".join(str(x) for x in (np.zeros(3) if load_m is None else load_m))
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
        <inertial pos="{place}" mass="{die.mass_kg}" diaginertia="{inertia} {inertia} {inertia}"/>{shapes}</body>
        </worldbody></mujoco>"""


if __name__ == "__main__":
    main()
