"""Render a set of clips with ground truth: other dice, surfaces and difficulties, each from a seed.

    PYTHONPATH=tests/helpers python benchmarks/make_clips.py OUT_FOLDER [NAME...] [--variant llvm_ad_mono] [--samples 48]

A clip takes minutes. `benchmarks/tracker.py OUT_FOLDER/*` then measures the tracker on them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from footage_files import write_photron
from numpy.typing import NDArray

from diethrow.commands.model.film_truth import visibility
from diethrow.commands.model.filmed_throw import FilmJob, scene_text, write_clip
from diethrow.files.outputs import whole_folder
from diethrow.model.die.die import Die, make_die
from diethrow.model.laws import CoulombImpact, SmoothImpact
from diethrow.model.throw.motion import State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.replay.render.mitsuba_scene import Appearance, lamp_beside
from diethrow.replay.render.renderer import RenderSettings
from diethrow.replay.render.sensor import Sensor
from diethrow.tracking.camera import Camera
from diethrow.tracking.footage.clip import open_clip

Array = NDArray[np.float64]

FPS = 1500.0
SIZE_PX = 384
DENSITY_KG_M3 = 1180.0
"""Acrylic."""
MAX_SEEDS = 2000
"""Most seeds that are tried for a throw with enough bounces in view."""
MIN_BOUNCE_FRAMES = 2.0
"""Least time between two bounces, in frames: closer ones are one contact to a camera."""


@dataclass(frozen=True)
class Case:
    """The die, table and camera of one clip."""

    shape: str
    edge_m: float
    surface: str
    seed: int
    marks: str | None = None
    corner_radius_m: float = 0.0
    chi: float = 0.55
    mu: float = 0.0
    spin_rad_s: float = 25.0
    exposure_s: float = 2e-4
    frames: int = 170
    width_m: float = 0.088
    """Width of the picture at the die."""
    height_m: float = 0.04
    """Height of the release above contact."""
    distortion: float = 0.0
    """k1."""
    bit_depth: int = 8
    noise: float = 1.0
    paint: float = 0.75
    table_tone: float = 1.0
    brightest: float = 0.8
    rod: bool = False
    bounces: int = 2
    """Fewest bounces in view."""
    note: str = ""


CASES = {
    "octahedron_numbers": Case("octahedron", 0.017, "wood", 11, "numbers", note="sharp, numbers, wood"),
    "dodecahedron_numbers": Case(
        "dodecahedron", 0.0075, "granite", 12, "numbers", 0.0003, note="edges rounded at 0.3 mm, granite"
    ),
    "icosahedron_plain": Case(
        "icosahedron", 0.011, "cork", 13, chi=0.65, note="plain faces: only edges determine the pose; cork"
    ),
    "tetrahedron_fast": Case("tetrahedron", 0.021, "wood", 14, spin_rad_s=70.0, note="70 rad/s at release, sharp"),
    "cube_low_contrast": Case(
        "cube",
        0.016,
        "matte",
        15,
        "pips",
        paint=0.36,
        table_tone=1.25,
        noise=2.5,
        brightest=0.5,
        note="grey die on grey table, noise 2.5 times the ordinary",
    ),
    "cube_strong_blur": Case(
        "cube", 0.016, "wood", 16, "pips", spin_rad_s=60.0, exposure_s=1 / 1500, note="exposed all the time, 60 rad/s"
    ),
    "cube_behind_rod": Case(
        "cube", 0.016, "cork", 17, "pips", rod=True, note="a rod 4 mm thick hides part of the die on some frames"
    ),
    "cube_mirror": Case(
        "cube", 0.015, "mirror", 18, "pips", 0.0006, chi=0.45, note="mirror table, edges rounded at 0.6 mm"
    ),
    "cube_rounded_friction": Case(
        "cube",
        0.016,
        "granite",
        19,
        "pips",
        0.0008,
        chi=0.6,
        mu=0.25,
        distortion=-0.5,
        note="edges rounded at 0.8 mm, friction 0.25, barrel distortion, granite",
    ),
    "cube_12bit": Case(
        "cube", 0.014, "wood", 20, "pips", 0.0003, bit_depth=12, brightest=0.6, note="packed 12-bit .mraw"
    ),
    "cube_to_rest": Case(
        "cube",
        0.016,
        "wood",
        21,
        "pips",
        chi=0.3,
        mu=0.3,
        frames=360,
        height_m=0.03,
        note="chatters, rolls over edges and comes to rest",
    ),
    "cube_small": Case(
        "cube", 0.012, "cork", 22, "pips", width_m=0.24, frames=200, height_m=0.05, note="20 px along an edge"
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Render the clips that are not there yet."""
    parser = argparse.ArgumentParser(description="Render a bench of clips with truth.")
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", default=list(CASES), metavar="NAME")
    parser.add_argument("--variant", default="scalar_rgb")
    parser.add_argument("--samples", type=int, default=48)
    chosen = parser.parse_intermixed_args(arguments)
    for name in chosen.names:
        if (chosen.out / name).exists():
            print(f"{name}: is there")
            continue
        job = job_of(name, CASES[name], RenderSettings(chosen.samples, 1, chosen.variant))
        with whole_folder(chosen.out / name) as folder:
            write_clip(folder, job)
            if job.sensor.bit_depth == 12:
                as_photron(folder, job)
        print(f"{name}: {job.frames} frames, {len(job.throw.bounces)} bounces", flush=True)
    lines = [f"{name}: {case.note}" for name, case in CASES.items() if (chosen.out / name).exists()]
    head = "Rendered clips with their truth (benchmarks/make_clips.py). Where there is friction: Newton's restitution."
    (chosen.out / "README.txt").write_text("\n".join([head, "", *lines, ""]))
    return 0


def job_of(name: str, case: Case, effort: RenderSettings) -> FilmJob:
    """The first throw of the case's random ones that stays in view over enough bounces."""
    density = DENSITY_KG_M3 * volume_m3(case.shape, case.edge_m)
    die = make_die(case.shape, case.edge_m, density, corner_radius_m=case.corner_radius_m, marks=case.marks)
    law = CoulombImpact(case.chi, case.mu, "newton") if case.mu else SmoothImpact(case.chi)
    for draw in range(MAX_SEEDS):
        rng = np.random.default_rng([case.seed, draw])
        camera = random_camera(case, rng)
        throw = throw_die(die, random_release(case, die, rng), law, until=Until(time_s=case.frames / FPS)).throw
        if stays_in_view(throw, die, camera, case):
            break
    else:
        raise ValueError(f"{name}: none of {MAX_SEEDS} throws stays in view; widen the picture")
    look = Appearance(
        lamp_beside(camera),
        die_reflectance=case.paint,
        table_factor=case.table_tone,
        lit_face_level=case.brightest,
        rods_m=(rod_before(throw, camera),) if case.rod else (),
        seed=case.seed,
    )
    plain = Sensor(case.bit_depth, seed=case.seed)
    sensor = replace(plain, full_well_e=plain.full_well_e / case.noise**2, read_noise_e=plain.read_noise_e / case.noise)
    blur = float(rng.uniform(0.5, 0.8))
    return FilmJob(
        name,
        throw,
        law,
        die,
        camera,
        case.surface,
        FPS,
        case.exposure_s,
        case.frames,
        look,
        sensor,
        blur_px=blur,
        rendering=effort,
        seed=case.seed,
    )


def volume_m3(shape: str, edge_m: float) -> float:
    solid = make_die(shape, edge_m, 1.0).solid
    tops = zip(solid.faces, solid.offsets, strict=True)
    return float(sum(area_m2(solid.vertices[list(face)]) * offset / 3.0 for face, offset in tops))


def area_m2(corners: Array) -> float:
    spokes = corners[1:] - corners[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]), axis=1).sum() / 2.0)


def random_camera(case: Case, rng: np.random.Generator) -> Camera:
    """About 0.6 m away, looking down at 22 to 36 degrees past a point a little above the table."""
    heading, pitch = rng.uniform(-0.5, 0.5), np.radians(rng.uniform(22.0, 36.0))
    ahead = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), -np.sin(pitch)])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    distance = rng.uniform(0.55, 0.7)
    focal = SIZE_PX * distance / case.width_m
    cx, cy = (SIZE_PX - 1) / 2 + rng.uniform(-8, 8, 2)
    matrix = np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]])
    target = np.array([*rng.uniform(-0.01, 0.01, 2), 0.25 * case.width_m])
    tilt = np.array([case.distortion, 0.0, 0.0, 0.0, 0.0])
    return Camera(SIZE_PX, SIZE_PX, matrix, tilt, rotation, -rotation @ (target - distance * ahead))


def random_release(case: Case, die: Die, rng: np.random.Generator) -> State:
    """A random orientation and axis, falling at about 0.8 m/s."""
    quaternion = rng.standard_normal(4)
    axis = rng.standard_normal(3)
    height = die.solid.circumradius + case.height_m
    velocity = np.array([*rng.uniform(-0.12, 0.12, 2), rng.uniform(-0.9, -0.6)])
    spin = case.spin_rad_s * rng.uniform(0.8, 1.2) * axis / np.linalg.norm(axis)
    position = np.array([*rng.uniform(-0.015, 0.015, 2), height])
    return State(0.0, position, quaternion / np.linalg.norm(quaternion), velocity, spin)


def stays_in_view(throw: Throw, die: Die, camera: Camera, case: Case) -> bool:
    """Seen whole from before the first bounce to the end, with enough separate bounces."""
    times = np.arange(case.frames) / FPS
    positions, _ = throw.poses(times)
    rotations = np.array([throw.at(float(t)).rotation for t in times])
    whole, _ = visibility(die, camera, positions, rotations)
    strikes = np.array([impact.time_s for impact in throw.bounces])
    first = int(strikes[0] * FPS) - 12 if len(strikes) else 0
    apart = np.diff(strikes, prepend=-1.0, append=np.inf) * FPS > MIN_BOUNCE_FRAMES
    lone = apart[:-1] & apart[1:] & (strikes < times[-1] - 0.01)
    return first >= 0 and bool(whole[first:].all()) and int(lone.sum()) >= case.bounces


def rod_before(throw: Throw, camera: Camera) -> tuple[tuple[float, ...], tuple[float, ...], float]:
    """An upright rod, 4 mm thick, in front of the die some time after its first bounce."""
    seen = throw.at(throw.bounces[0].time_s + 0.03).position_m
    foot = seen + 0.25 * (camera.centre_m - seen) + 0.004 * camera.rotation[0]
    return (float(foot[0]), float(foot[1]), 0.0), (float(foot[0]), float(foot[1]), 0.5), 0.002


def as_photron(folder: Path, job: FilmJob) -> None:
    """Put a Photron header and packed .mraw in the place of the film."""
    frames = np.stack(list(open_clip(folder / "clip.avi", fps=FPS).frames()))
    write_photron(
        folder / "clip.cihx", frames, stored_bits=12, record_rate_hz=int(FPS), shutter_hz=round(1 / job.exposure_s)
    )
    (folder / "clip.avi").unlink()
    (folder / "scene.toml").write_text(scene_text(job, "clip.cihx"))


if __name__ == "__main__":
    sys.exit(main())
