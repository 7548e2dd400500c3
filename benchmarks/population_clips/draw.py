"""What a random clip shows: die, paint, light, throw, camera, shutter, sensor and file, drawn from stated ranges.

Clip k of a seed is the same on every machine: everything comes from `numpy.random.default_rng([seed, k])`, and a throw that
leaves the picture is drawn again from the next numbers of the same generator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diethrow.model.die import MAX_CORNER_RADIUS_FRACTION, SHAPES, Die, make_die
from diethrow.model.laws import CoulombImpact, SmoothImpact
from diethrow.model.throw import State, Throw, Until, throw_die
from diethrow.tracking.camera import Camera

Array = NDArray[np.float64]

GRAVITY_M_S2 = 9.81
DENSITY_KG_M3 = (1050.0, 1400.0)
"""Polystyrene to phenolic resin."""
DIAMETER_M = (0.012, 0.022)
"""Of the circumscribed sphere of the smaller dice sold, to that of the larger ones."""
RADIUS_SHARE = (0.0, 0.15)
"""Corner radius in edges. A fifth of the dice is sharp."""
SHARP_SHARE = 0.2
GLOSSY_SHARE = 0.4
PLAIN_SHARE = 0.3
DIE_PX = (40.0, 150.0)
"""Projected diameter of the circumscribed sphere."""
FPS = (240.0, 5000.0)
EXPOSURE_SHARE = (0.03, 0.95)
"""Of the frame interval."""
MAX_SPIN_RAD_S = 70.0
MAX_TURN_PER_FRAME_RAD = 0.2
"""Spin at release is at most this times the rate: 48 rad/s at 240 frames/s."""
FALL_M = (0.03, 0.6)
"""Height of fall that gives the speed of the first impact."""
FRAMES = (100, 150)
SIZE_PX = (256, 720)
"""Width and height of the square picture: what the throw needs, within these."""
CHI = (0.25, 0.8)
FRICTION_SHARE = 0.3
MU = (0.05, 0.35)
CURVED_SHARE = 0.4
"""Clips whose grey levels are not proportional to light."""
ROLLING_SHARE = 0.5
"""Of the clips below 500 frames/s."""
ROLLING_BELOW_FPS = 500.0
BACKGROUND_SHARE = 0.85
"""Clips that come with a picture of the empty table."""
SURFACES = ("wood", "cork", "granite", "cloth", "matte")
CODECS = {"ffv1": 0.45, "h264": 0.3, "hevc": 0.1, "mjpeg": 0.15}
MAX_DRAWS = 400
MIN_SHOWN = 0.6
"""Least share of the frames that show the whole die."""
LONE_FRAMES = 2.0
MARGIN_FRAMES = 4.0
"""From a lone impact to either end of the clip, and to the nearest frame in which the die is not whole."""


@dataclass(frozen=True, eq=False)
class Draw:
    """One random clip."""

    seed: int
    number: int
    die: Die
    law: SmoothImpact | CoulombImpact
    throw: Throw
    camera: Camera
    surface: str
    fps: float
    frames: int
    exposure_s: float
    readout_s: float
    """From the first row to the last; 0 for a global shutter."""
    blur_px: float
    """Standard deviation of the lens's point spread, in the plane of focus."""
    gloss: float
    roughness_rad: float
    albedo: float
    mark_albedo: float
    grain: float
    """Relative standard deviation of the paint."""
    lamp_towards: Array
    """(3,) unit."""
    lamp_radius_rad: float
    ambient_share: float
    """Of the light on an upward face."""
    brightest: float
    """Level of a face turned to the lamp, of the largest level."""
    response: str | float
    black_level: float
    """Of the largest level."""
    full_well_e: float
    read_noise_e: float
    codec: str
    crf: int
    """Rate factor of H.264 and HEVC, quantiser of MJPEG."""
    has_background: bool

    @property
    def states_response(self) -> bool:
        """Whether the scene names the response: half of the scenes do where it is no straight line."""
        return self.response != "linear" and self.number % 2 == 0

    @property
    def kinds(self) -> tuple[str, ...]:
        """The groups of the table of rates that the clip belongs to."""
        share = self.die.corner_radius_m / self.die.solid.edge_m
        exposed = self.exposure_s * self.fps
        found = [self.die.solid.name, "marked" if self.die.marks else "plain"]
        found.append("sharp" if share == 0 else "rounded to 5 %" if share < 0.05 else "rounded over 5 %")
        if self.die.corner_radius_m > 0.5 * self.die.solid.inradius:
            found.append("rounded over half the inscribed radius")
        if self.gloss > 0:
            found.append("glossy")
        if self.response != "linear":
            found.append("display curve, stated" if self.states_response else "display curve, not stated")
        if self.codec != "ffv1":
            found.append(self.codec)
        if self.readout_s > 0:
            found.append("rolling shutter")
        if exposed > 0.5:
            found.append("exposed over half the time")
        if not self.has_background:
            found.append("no background")
        if self.fps < ROLLING_BELOW_FPS:
            found.append("below 500 frames/s")
        if not (share > 0 or self.gloss > 0 or self.response != "linear" or self.codec != "ffv1" or exposed > 0.5):
            found.append("clean")
        return tuple(found)


def draw_clip(seed: int, number: int) -> Draw:
    """Clip `number` of a seed. Raises RuntimeError where MAX_DRAWS throws in a row left the picture."""
    rng = np.random.default_rng([seed, number])
    die, albedo = _die(rng)
    diameter_px = _log_uniform(rng, *DIE_PX)
    fps = float(np.round(_log_uniform(rng, *FPS)))
    frames = int(rng.integers(FRAMES[0], FRAMES[1] + 1))
    exposure_s = _log_uniform(rng, *EXPOSURE_SHARE) / fps
    rolling = fps < ROLLING_BELOW_FPS and rng.random() < ROLLING_SHARE
    readout_s = float(rng.uniform(0.3, 0.8) / fps) if rolling else 0.0
    chi = float(rng.uniform(*CHI))
    law: SmoothImpact | CoulombImpact = SmoothImpact(chi)
    if rng.random() < FRICTION_SHARE:
        law = CoulombImpact(chi, float(rng.uniform(*MU)), "newton")
    for _ in range(MAX_DRAWS):
        throw, camera = _throw(rng, die, law, diameter_px, fps, frames)
        if camera is not None and _is_shown(throw, die, camera, fps, frames):
            break
    else:
        raise RuntimeError(f"clip {number} of seed {seed}: {MAX_DRAWS} throws in a row left the picture")
    response: str | float = "linear"
    if rng.random() < CURVED_SHARE:
        response = "srgb" if rng.random() < 0.5 else float(np.round(rng.uniform(0.4, 0.7), 2))
    codec = str(rng.choice(list(CODECS), p=list(CODECS.values())))
    glossy = rng.random() < GLOSSY_SHARE
    heading = np.arctan2(*(camera.centre_m[:2][::-1])) + rng.uniform(-1.2, 1.2)
    height = rng.uniform(0.5, 1.2)
    return Draw(
        seed=seed,
        number=number,
        die=die,
        law=law,
        throw=throw,
        camera=camera,
        surface=str(rng.choice(SURFACES)),
        fps=fps,
        frames=frames,
        exposure_s=float(exposure_s),
        readout_s=readout_s,
        blur_px=float(rng.uniform(0.45, 0.9)),
        gloss=float(rng.uniform(0.3, 1.0)) if glossy else 0.0,
        roughness_rad=float(rng.uniform(0.05, 0.25)),
        albedo=albedo,
        mark_albedo=float(albedo * rng.uniform(0.08, 0.45) if albedo > 0.35 else rng.uniform(0.6, 0.85)),
        grain=float(rng.uniform(0.0, 0.03)),
        lamp_towards=np.array([np.cos(heading) * np.cos(height), np.sin(heading) * np.cos(height), np.sin(height)]),
        lamp_radius_rad=float(rng.uniform(0.03, 0.3)),
        ambient_share=float(rng.uniform(0.15, 0.5)),
        brightest=float(rng.uniform(0.5, 0.9)),
        response=response,
        black_level=float(rng.uniform(0.0, 0.04)),
        full_well_e=_log_uniform(rng, 5000.0, 30000.0),
        read_noise_e=float(rng.uniform(8.0, 40.0)),
        codec=codec,
        crf=int(rng.integers(3, 8)) if codec == "mjpeg" else int(rng.integers(16, 27)),
        has_background=bool(rng.random() < BACKGROUND_SHARE),
    )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _die(rng: np.random.Generator) -> tuple[Die, float]:
    """The die, and the albedo of its paint."""
    shape = str(rng.choice(SHAPES))
    unit = make_die(shape, 1.0, 1.0).solid
    edge_m = float(np.round(rng.uniform(*DIAMETER_M) / (2.0 * unit.circumradius), 5))
    share = 0.0 if rng.random() < SHARP_SHARE else rng.uniform(*RADIUS_SHARE)
    share = min(share, 0.999 * MAX_CORNER_RADIUS_FRACTION * unit.inradius)
    marks = None
    if rng.random() >= PLAIN_SHARE:
        marks = "pips" if shape == "cube" and rng.random() < 0.8 else "numbers"
    volume = sum(_area(unit.vertices[list(face)]) * h / 3.0 for face, h in zip(unit.faces, unit.offsets, strict=True))
    mass_kg = float(volume * edge_m**3 * rng.uniform(*DENSITY_KG_M3))
    albedo = float(rng.uniform(0.55, 0.85) if rng.random() < 0.75 else rng.uniform(0.05, 0.3))
    # The inertia of the sharp body, which the scene states: the throw of a seed does not change with the model.
    inertia_kg_m2 = make_die(shape, edge_m, mass_kg).inertia_kg_m2
    die = make_die(
        shape, edge_m, mass_kg, inertia_kg_m2=inertia_kg_m2, corner_radius_m=float(share * edge_m), marks=marks
    )
    return die, albedo


def _area(corners: Array) -> float:
    spokes = corners[1:] - corners[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]), axis=1).sum() / 2.0)


def _throw(
    rng: np.random.Generator, die: Die, law: SmoothImpact | CoulombImpact, diameter_px: float, fps: float, frames: int
) -> tuple[Throw, Camera | None]:
    """A throw that strikes the table in the first half of the clip, and a camera that sees it; None where it cannot."""
    size_m = die.solid.circumradius
    before_s = rng.uniform(0.15, 0.45) * frames / fps
    speed = np.sqrt(2.0 * GRAVITY_M_S2 * _log_uniform(rng, *FALL_M))
    spin = min(rng.uniform(0.0, MAX_SPIN_RAD_S), MAX_TURN_PER_FRAME_RAD * fps)
    across = rng.uniform(0.0, 0.5) * speed
    heading = rng.uniform(0.0, 2.0 * np.pi)
    # At the first impact the centre is between the inscribed and the circumscribed sphere; back from there along the fall.
    height = 0.5 * (die.solid.inradius + size_m) + speed * before_s - 0.5 * GRAVITY_M_S2 * before_s**2
    velocity = np.array([across * np.cos(heading), across * np.sin(heading), GRAVITY_M_S2 * before_s - speed])
    axis, quaternion = rng.standard_normal(3), rng.standard_normal(4)
    middle_s = 0.5 * frames / fps
    position = np.array([*(-0.6 * velocity[:2] * middle_s), max(height, 1.02 * size_m)])
    release = State(
        0.0, position, quaternion / np.linalg.norm(quaternion), velocity, spin * axis / np.linalg.norm(axis)
    )
    throw = throw_die(die, release, law, until=Until(time_s=frames / fps)).throw
    return throw, _camera(rng, throw, die, diameter_px, fps, frames)


def _camera(
    rng: np.random.Generator, throw: Throw, die: Die, diameter_px: float, fps: float, frames: int
) -> Camera | None:
    """Looking down at 10 to 55 degrees from 0.4 to 1.2 m, aimed at where the die is after its first impact."""
    positions = throw.poses(np.arange(frames) / fps)[0]
    heading, pitch = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(10.0, 55.0))
    ahead = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), -np.sin(pitch)])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    roll = np.radians(rng.uniform(-4.0, 4.0))
    down = np.cross(ahead, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    rotation = np.array([right, down, ahead])
    distance = rng.uniform(0.4, 1.2)
    focal = diameter_px * distance / (2.0 * die.solid.circumradius)
    later = positions[int(0.3 * frames) :]
    target = 0.5 * (later.min(0) + later.max(0))
    centre = target - distance * ahead
    seen = (positions - centre) @ rotation.T
    image = focal * seen[:, :2] / seen[:, 2:]
    reach = np.abs(image[int(0.2 * frames) :]).max() + 0.6 * diameter_px + 10.0
    size = int(2 * np.ceil(max(reach, SIZE_PX[0] / 2) / 8.0) * 8)
    if size > SIZE_PX[1]:
        return None
    middle = (size - 1) / 2 + rng.uniform(-6.0, 6.0, 2)
    matrix = np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])
    # Barrel or pincushion distortion of up to about 1 % at the edge of the picture.
    k1 = rng.uniform(-1.0, 1.0) * 0.01 / (0.5 * size / focal) ** 2 if rng.random() < 0.5 else 0.0
    distortion = np.array([k1, 0.0, 0.0, 0.0, 0.0])
    return Camera(size, size, matrix, distortion, rotation, -rotation @ centre)


def _is_shown(throw: Throw, die: Die, camera: Camera, fps: float, frames: int) -> bool:
    """Whether enough frames show the whole die and there is a lone impact in view."""
    times = np.arange(frames) / fps
    positions = throw.poses(times)[0]
    pixels = camera.project(positions)
    depth = (positions - camera.centre_m) @ camera.rotation[2]
    reach = camera.matrix[0, 0] * die.solid.circumradius / depth + 2.0
    whole = ((pixels - reach[:, None] > 0) & (pixels + reach[:, None] < camera.width_px - 1)).all(1)
    if whole.mean() < MIN_SHOWN:
        return False
    strikes = np.array([impact.time_s for impact in throw.impacts]) * fps
    for k, frame in enumerate(strikes):
        others = np.delete(strikes, k)
        near = slice(max(int(frame - MARGIN_FRAMES), 0), int(frame + MARGIN_FRAMES) + 2)
        inside = MARGIN_FRAMES < frame < frames - 1 - 2 * MARGIN_FRAMES
        if inside and whole[near].all() and (np.abs(others - frame) > 2 * LONE_FRAMES).all():
            return True
    return False
