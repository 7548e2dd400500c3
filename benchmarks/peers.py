"""The event-driven throw compared with general physics engines: `python benchmarks/peers.py`, with the engines installed
(`pip install mujoco==4.0.0 dartpy==6.20.0`); an engine that is not installed is left out, with a line.

All throw the same: a sharp cube of 2 cm and 16 g, released at rest 0.3 m above the table, uniformly turned, with 40 rad/s
about a uniformly random axis, without friction. In every engine a throw ends as soon as the die has too little energy to
leave its lowest face (checked every 16 ms of the motion). Two tables:

speed        throws a second, by the CPU time of one core, at χ 0.5. diethrow and the engines take turns, so that a busy
             machine affects all equally. The ratio diethrow : engine is taken in each round, and its median and range are
             printed. Compiling diethrow and building the engines' worlds is not counted.
agreement    at χ 0.1, as the engine's step shrinks: throws that land on the same face as in diethrow (chance: 17 %), with
             the Wilson 95 % interval; and the errors, median and 90th percentile over the throws, of the height of the
             centre and of the orientation shortly after the first, second and third vertex struck the table (at the
             next multiple of 2 ms that is at least 1 ms later).

Each engine is set up as near as possible to a rigid impact without friction and with the restitution χ:
DART     has a restitution, so it gets χ. It suppresses rebounds slower than 0.1 units of length a second, and limits them
         to 100. Its unit of length is χ × 5 cm, so that impacts below 5 mm/s do not rebound, and those up to 5 m/s, more
         than any vertex of these throws has, rebound fully. Bodies never fall asleep. All else is the default.
MuJoCo   has no restitution. Its contact is a spring and a damper, and with an impedance of nearly 1 (solimp) they set the
         acceleration of the vertex, whatever its arm and the die's mass. A soft spring lets the die turn during the
         contact. With one that is too stiff for the step, the rebound depends on where in the step the vertex met the
         table. Both errors are about equal, and shrink, with an angular frequency of 300/s at 1 ms (a contact of some
         ten steps) that grows as the step's power -2/3. The damping is the one with which the cube, dropped onto a
         vertex, rises with χ times its speed, on average over eight drops spread over a step. No friction (condim 1).
Both change the velocity before the position (semi-implicit Euler). They are released with the velocity of half a step
earlier, which makes their parabola the exact one. Otherwise they would miss it by g × time × step / 2: by more than 1 mm
at the first impact, with a step of 1 ms.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from math import acos, pi, sqrt
from typing import Any, Protocol

import numpy as np
from measuring import spread, timed
from numpy.typing import NDArray
from scipy.stats import binomtest

from diethrow.model import engine
from diethrow.model.die.die import make_die
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    rotvec_from_quat,
)
from diethrow.model.throw.body import body_of
from diethrow.model.throw.motion import State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.model.world import GRAVITY_M_S2

Array = NDArray[np.float64]

DIE = make_die("cube", 0.02, 0.016)
BODY = body_of(DIE)
HEIGHT_M, SPIN_RAD_S = 0.3, 40.0
COARSEST_STEP_S = 1e-3
"""[s] MuJoCo's default step; the finer steps halve it repeatedly."""

CHECK_INTERVAL_S = 0.016
"""[s] of motion between two checks whether the die can still leave its face."""

MAX_DURATION_S = 8.0
"""[s] of motion after which an engine's throw is stopped, landed on no face."""

COMPARISON_GRID_S = 0.002
"""[s] States are compared at multiples of this time, which every step divides."""

COMPARISON_DELAY_S = 0.001
"""[s] Least delay of a comparison after an impact, so that a contact of finite duration is over."""


class PeerEngine(Protocol):
    """A general physics engine with one die above one table."""

    step_s: float

    def release(self, state: Array) -> None:
        """Put the die into a state (13,): position, quaternion wxyz, velocity and angular velocity in world axes."""
        ...

    def advance(self, steps: int) -> None:
        """Move on by some steps."""
        ...

    def state(self) -> Array:
        """The state (13,)."""
        ...


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", nargs="+", choices=("speed", "agreement"), default=["speed", "agreement"])
    parser.add_argument("--engines", nargs="+", choices=sorted(ENGINES), default=list(ENGINES))
    parser.add_argument("--rounds", type=int, default=7, help="rounds of the speed table (default %(default)s)")
    parser.add_argument(
        "--throws", type=int, default=200, help="an engine throws in each round, and to agree (%(default)s)"
    )
    parser.add_argument("--halvings", type=int, default=7, help="of the step of 1 ms, to the finest (%(default)s)")
    parser.add_argument("--speed-chi", type=float, default=0.5, help="χ of the speed table (%(default)s)")
    parser.add_argument("--agreement-chi", type=float, default=0.1, help="χ of the agreement table (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the releases (%(default)s)")
    chosen = parser.parse_args(arguments)
    engines = installed(chosen.engines)
    if "speed" in chosen.tables:
        print_speed(engines, chosen.speed_chi, chosen.rounds, releases(chosen.throws, chosen.seed))
    if "agreement" in chosen.tables:
        print_agreement(engines, chosen.agreement_chi, chosen.halvings, releases(chosen.throws, chosen.seed))
    return 0


def installed(names: Sequence[str]) -> dict[str, MakeEngine]:
    """The engines that can be imported; a line is printed for each that cannot."""
    found = {}
    for name in names:
        make, module = ENGINES[name]
        try:
            importlib.import_module(module)
        except ImportError as error:
            print(f"{name} is left out: {error}".splitlines()[0])
            continue
        found[f"{name} {version(module)}"] = make
    return found


def releases(count: int, seed: int) -> Array:
    """States (count, 13) of the throws; the first ones are the same for every count."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(size=(count, 7))
    states = np.zeros((count, 13))
    states[:, 2] = HEIGHT_M
    states[:, 3:7] = drawn[:, :4] / np.linalg.norm(drawn[:, :4], axis=1)[:, None]
    states[:, 10:] = SPIN_RAD_S * drawn[:, 4:] / np.linalg.norm(drawn[:, 4:], axis=1)[:, None]
    return states


# --- speed ------------------------------------------------------------------------------------------------------------


def print_speed(engines: dict[str, MakeEngine], chi: float, rounds: int, starts: Array) -> None:
    """Throws a second of each engine at 1 ms, and of diethrow."""
    _, compiled_s = timed(partial(our_faces, starts[:2], chi), time.perf_counter)
    worlds = {name: make(chi, COARSEST_STEP_S) for name, make in engines.items()}
    many = np.tile(starts, (100, 1))  # takes about as long as the engines do
    ours: list[float] = []
    theirs: dict[str, list[float]] = {name: [] for name in worlds}
    for _ in range(rounds):
        ours.append(len(many) / timed(partial(our_faces, many, chi))[1])
        for name, world in worlds.items():
            theirs[name].append(len(starts) / timed(partial(landed_faces, world, starts))[1])
    print(
        f"\nThrows a second on one core, χ {chi:g}, engines at {COARSEST_STEP_S * 1e3:g} ms; median (range) of {rounds} rounds"
    )
    print(f"{'':14}{'throws/s':>26}   diethrow is faster by")
    print(f"{'diethrow':14}{spread(ours):>26}   (compiled or loaded in {compiled_s:.1f} s before)")
    for name, rates in theirs.items():
        print(f"{name:14}{spread(rates):>26}   {spread([a / b for a, b in zip(ours, rates, strict=True)])}")


def our_faces(starts: Array, chi: float) -> NDArray[np.int64]:
    """Numbers (n,) of the faces on which the throws of diethrow land."""
    return ThrowSetup(DIE, SmoothImpact(chi)).throw(starts).face


def landed_faces(peer: PeerEngine, starts: Array) -> list[int]:
    """Numbers of the faces on which an engine's throws land; 0 for none in time."""
    faces = []
    for start in starts:
        peer.release(half_a_step_earlier(start, peer.step_s))
        faces.append(face_at_rest(peer))
    return faces


def half_a_step_earlier(start: Array, step_s: float) -> Array:
    """The state with the velocity of half a step before."""
    earlier = start.copy()
    earlier[9] += 0.5 * GRAVITY_M_S2 * step_s
    return earlier


def face_at_rest(peer: PeerEngine) -> int:
    """Run an engine until the die cannot leave its lowest face; the number of that face, or 0 for none in time."""
    steps = round(CHECK_INTERVAL_S / peer.step_s)
    law = engine.law_of(engine.SMOOTH, np.array([0.0]))
    for _ in range(round(MAX_DURATION_S / CHECK_INTERVAL_S)):
        peer.advance(steps)
        state = peer.state()
        # Cheap, and necessary: the decision needs at least this part of the energy to be below the barrier.
        if 0.5 * state[9] ** 2 + GRAVITY_M_S2 * state[2] < GRAVITY_M_S2 * BODY.radius:
            face = engine.decided_face(BODY, law, engine.LEVEL, state)
            if face >= 0:
                return int(face) + 1
    return 0


# --- agreement --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Truth:
    """A throw of diethrow, as far as it is compared."""

    face: int | None
    """Number of the landed face; None if it is not decided."""
    states: tuple[State, ...]
    """Shortly after the first, second and third vertex struck; fewer if fewer did."""


def print_agreement(engines: dict[str, MakeEngine], chi: float, halvings: int, starts: Array) -> None:
    """A table for each engine: faces and errors against the step."""
    truths = [our_throw(start, chi) for start in starts]
    head = f"{'step [µs]':>9} {'throws/s':>9} {'same face':>21}"
    for name, make in engines.items():
        print(f"\n{name} against the event-driven throw, χ {chi:g}, {len(starts)} throws")
        print(f"{'':41}" + "".join(f"{f'error after vertex {k} [mm; °]':>33}" for k in (1, 2, 3)))
        print(head + 3 * f"{'median, 90 %; median, 90 %':>33}")
        for k in range(halvings + 1):
            print(agreement_row(make(chi, COARSEST_STEP_S / 2**k), starts, truths), flush=True)


def our_throw(start: Array, chi: float) -> Truth:
    """One throw of diethrow."""
    release = State(0.0, start[:3], start[3:7], start[7:10], start[10:])
    result = throw_die(DIE, release, SmoothImpact(chi), until=Until(time_s=MAX_DURATION_S))
    times = strike_times_s(result.throw)
    compared = (np.ceil((t + COMPARISON_DELAY_S) / COMPARISON_GRID_S) * COMPARISON_GRID_S for t in times[:3])
    return Truth(result.landed_face, tuple(result.throw.at(t) for t in compared))


def strike_times_s(throw: Throw) -> list[float]:
    """The instants [s] of the first impact of each vertex, in order."""
    first: dict[int, float] = {}
    for bounce in throw.bounces:
        for vertex in bounce.vertices:
            first.setdefault(vertex, bounce.time_s)
    return sorted(first.values())


def agreement_row(peer: PeerEngine, starts: Array, truths: Sequence[Truth]) -> str:
    """The row of one engine at one step."""
    errors: list[list[tuple[float, float]]] = [[], [], []]
    same = 0
    began = time.process_time()
    for start, truth in zip(starts, truths, strict=True):
        peer.release(half_a_step_earlier(start, peer.step_s))
        done = 0
        for k, ours in enumerate(truth.states):
            steps = round(ours.time_s / peer.step_s)
            peer.advance(steps - done)
            done = steps
            errors[k].append(state_error(peer.state(), ours))
        same += face_at_rest(peer) == truth.face
    rate = len(starts) / (time.process_time() - began)
    wilson = binomtest(same, len(starts)).proportion_ci(method="wilson")
    share = f"{same / len(starts):.1%} ({wilson.low:.0%} to {wilson.high:.0%})"
    return f"{peer.step_s * 1e6:9.4g} {rate:9.3g} {share:>21}" + "".join(f"{error_text(e):>33}" for e in errors)


def state_error(theirs: Array, ours: State) -> tuple[float, float]:
    """Height [mm] and orientation [°]."""
    turn = rotvec_from_quat(quat_multiply(theirs[3:7], quat_conjugate(ours.quaternion)))
    return 1e3 * abs(float(theirs[2] - ours.position_m[2])), float(np.degrees(np.linalg.norm(turn)))


def error_text(errors: Sequence[tuple[float, float]]) -> str:
    """Median and 90th percentile of heights and orientations."""
    (height, turn), (high, far) = np.percentile(np.array(errors), [50, 90], axis=0)
    return f"{height:.2g}, {high:.2g}; {turn:.2g}, {far:.2g}"


# --- the engines ------------------------------------------------------------------------------------------------------


class Mujoco:
    """MuJoCo: a free box above a plane."""

    def __init__(self, chi: float, step_s: float, damping: float | None = None) -> None:
        self.step_s = step_s
        self._mujoco = importlib.import_module("mujoco")
        self._model = self._mujoco.MjModel.from_xml_string(mujoco_world(step_s))
        self._data = self._mujoco.MjData(self._model)
        frequency, ratio = contact_frequency(step_s), mujoco_damping(chi, step_s) if damping is None else damping
        # Negative values are the stiffness and the damping themselves.
        self._model.geom_solref[:] = -(frequency**2), -2.0 * ratio * frequency

    def release(self, state: Array) -> None:
        """As `Engine`; MuJoCo's angular velocity is in body axes."""
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = state[:7]
        self._data.qvel[:3] = state[7:10]
        self._data.qvel[3:] = state[10:] @ matrix_from_quat(state[3:7])

    def advance(self, steps: int) -> None:
        """As `PeerEngine`."""
        self._mujoco.mj_step(self._model, self._data, nstep=steps)

    def state(self) -> Array:
        """As `PeerEngine`."""
        qpos, qvel = self._data.qpos, self._data.qvel
        return np.concatenate([qpos, qvel[:3], matrix_from_quat(qpos[3:7]) @ qvel[3:]])


def mujoco_world(step_s: float) -> str:
    """The MuJoCo model; spring and damper of the contact are set afterwards."""
    half, inertia = 0.5 * DIE.solid.edge_m, DIE.inertia_kg_m2
    return f"""<mujoco>
      <option timestep="{step_s!r}" gravity="0 0 {-GRAVITY_M_S2}"/>
      <default><geom condim="1" solimp="0.9999 0.9999 0.001"/></default>
      <worldbody>
        <geom type="plane" size="0 0 1"/>
        <body><freejoint/>
          <inertial pos="0 0 0" mass="{DIE.mass_kg!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
          <geom type="box" size="{half!r} {half!r} {half!r}"/>
        </body>
      </worldbody></mujoco>"""


def contact_frequency(step_s: float) -> float:
    """Angular frequency [1/s] of MuJoCo's contact spring."""
    return 300.0 * float((1e-3 / step_s) ** (2.0 / 3.0))


def mujoco_damping(chi: float, step_s: float) -> float:
    """The damping ratio at which the cube rises from drops onto a vertex with χ times its speed."""
    # With more damping the damper alone would reverse the velocity within a step.
    low, high = 0.0, 0.5 / (contact_frequency(step_s) * step_s)
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if mean_rebound(Mujoco(chi, step_s, middle)) > chi else (low, middle)
    return 0.5 * (low + high)


def mean_rebound(peer: PeerEngine) -> float:
    """The restitution of drops onto a vertex at 2 m/s that meet the table at eight instants within a step."""
    return float(np.mean([rebound(peer, (k + 0.5) / 8) for k in range(8)]))


def rebound(peer: PeerEngine, phase: float) -> float:
    """The restitution of a drop onto a vertex at 2 m/s that meets the table after a part of a step."""
    speed, radius = 2.0, DIE.solid.circumradius
    upright = quat_multiply(quat_from_rotvec([acos(1.0 / sqrt(3.0)), 0.0, 0.0]), quat_from_rotvec([0.0, 0.0, pi / 4]))
    height = radius + phase * speed * peer.step_s
    peer.release(np.concatenate([[0.0, 0.0, height], upright, [0.0, 0.0, -speed], [0.0, 0.0, 0.0]]))
    peer.advance(1)
    for _ in range(round(0.1 / peer.step_s)):
        peer.advance(1)
        state = peer.state()
        if state[2] > radius:
            return sqrt(state[9] ** 2 + 2.0 * GRAVITY_M_S2 * (state[2] - radius)) / speed
    return 0.0


class Dart:
    """DART: a box on a free joint above a large box."""

    def __init__(self, chi: float, step_s: float) -> None:
        self.step_s = step_s
        self._unit_m = unit_m = 0.05 * max(chi, 0.02)
        dart = importlib.import_module("dartpy")
        self._world = dart.simulation.World()
        self._world.setTimeStep(step_s)
        self._world.setGravity([0.0, 0.0, -GRAVITY_M_S2 / unit_m])
        sleep = self._world.getDeactivationOptions()
        sleep.mEnabled = False
        self._world.setDeactivationOptions(sleep)
        self._die = dart.dynamics.Skeleton("die")
        _, self._body = self._die.createFreeJointAndBodyNodePair()
        add_box(dart, self._body, [DIE.solid.edge_m / unit_m] * 3, chi)
        inertia = DIE.inertia_kg_m2 / unit_m**2
        self._body.setInertia(dart.dynamics.Inertia(DIE.mass_kg, [0.0, 0.0, 0.0], inertia * np.eye(3)))
        table = dart.dynamics.Skeleton("table")
        _, slab = table.createWeldJointAndBodyNodePair()
        add_box(dart, slab, [10.0 / unit_m, 10.0 / unit_m, 1.0 / unit_m], 1.0).setRelativeTranslation(
            [0.0, 0.0, -0.5 / unit_m]
        )
        self._world.addSkeleton(self._die)
        self._world.addSkeleton(table)

    def release(self, state: Array) -> None:
        """As `PeerEngine`."""
        self._world.reset()
        self._die.setPositions(np.concatenate([rotvec_from_quat(state[3:7]), state[:3] / self._unit_m]))
        self._die.setVelocities(np.concatenate([state[10:], state[7:10] / self._unit_m]))

    def advance(self, steps: int) -> None:
        """As `PeerEngine`."""
        step = self._world.step
        for _ in range(steps):
            step()

    def state(self) -> Array:
        """As `PeerEngine`."""
        pose, body = self._body.getWorldTransform(), self._body
        quaternion = quat_from_matrix(np.asarray(pose.rotation()))
        position, velocity = (
            np.asarray(pose.translation()) * self._unit_m,
            np.asarray(body.getLinearVelocity()) * self._unit_m,
        )
        return np.concatenate([position, quaternion, velocity, np.asarray(body.getAngularVelocity())])


def add_box(dart: Any, body: Any, sides: Sequence[float], chi: float) -> Any:
    """Give a DART body a box without friction. The restitution of a contact is the product of the two."""
    node = body.createShapeNode(dart.dynamics.BoxShape(sides))
    node.createCollisionAspect()
    surface = node.createDynamicsAspect()
    surface.setRestitutionCoeff(chi)
    surface.setFrictionCoeff(0.0)
    return node


MakeEngine = Callable[[float, float], PeerEngine]
"""From χ and a step [s]."""

ENGINES: dict[str, tuple[MakeEngine, str]] = {"MuJoCo": (Mujoco, "mujoco"), "DART": (Dart, "dartpy")}
"""By name: its class, and the module that it needs."""

if __name__ == "__main__":
    sys.exit(main())
