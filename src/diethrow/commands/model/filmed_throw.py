"""A simulated throw as a clip: the images that a given camera would record, with the true motion.

The folder contains a scene file, the clip, an image of the empty table and the truth (`truth`). `diethrow analyze
DIR/scene.toml` analyses it, and `benchmarks/tracker.py` compares the analysis with the truth.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...files.outputs import whole_folder
from ...files.plan import Plan
from ...files.provenance import Stopwatch, write_provenance
from ...files.scene import Scene
from ...files.settings import refuse
from ...files.truth import write_truth
from ...model.die import Die
from ...model.laws import CoulombImpact, SmoothImpact
from ...model.throw import State, Throw, Until, throw_die
from ...replay.render import (
    Appearance,
    FilmRenderer,
    FixedPattern,
    RenderSettings,
    Sensor,
    expose,
    fixed_pattern,
    frame_light,
    lamp_beside,
    rounded,
)
from ...tracking.camera import Camera
from ...tracking.footage import Response, grey_of, is_linear

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

EXPOSURE_S = 2e-4
"""Default exposure without a scene: half a pixel of blur at 2 m/s and 1.3 px/mm, a tenth of a disturbing blur."""
FIELD_OF_VIEW_RAD = 0.15
"""Field of view without a scene: a lens of 100 mm on a sensor of 15 mm."""
DEPRESSION_RAD = np.radians(28.0)
"""Angle below the horizontal at which the camera points, without a scene."""
HEADING_RAD = np.radians(20.0)
"""Heading of the camera from the y axis, without a scene: no face of a die at rest is seen edge-on."""
MAX_FRAMES = 100_000
MAX_SIZE_PX = 8192
MIN_SIZE_PX = 16
AFTER_LANDING_S = 0.05
"""Time that a film continues after the landing face is decided, to show the die come to rest."""
BACKGROUND_EXPOSURES = 16
"""Exposures of the empty table whose mean is the background, so that it has little noise."""
NO_NOISE_WELL_E = 1e15
"""Full well of a sensor without noise [electrons]: its shot noise is far below a grey level."""
PIXEL_FORMATS = {8: "gray", 10: "gray10le", 12: "gray12le", 16: "gray16le"}
"""FFV1's pixel format for each bit depth that common readers support."""
AVI_FPS = 30
"""Nominal rate of the clip's container, because AVI refuses 1500 frames per second; the scene states the true rate."""


@dataclass(frozen=True)
class FilmSettings:
    """Settings of a film besides the throw and the scene."""

    frames: int | None = None
    """Number of frames; None for the whole throw."""
    start_s: float = 0.0
    """Time after the release at which the clip begins; its time is 0 there."""
    size_px: int = 512
    """Width and height without a scene."""
    fps: float | None = None
    """Recording rate; None for that of the scene or the throw file."""
    exposure_s: float | None = None
    """None for the exposure of the scene, or EXPOSURE_S."""
    response: Response = None
    """How grey levels follow light; None for the response of the scene, or linear."""
    bit_depth: int = 8
    noise: float = 1.0
    """Factor on the sensor's read noise, fixed-pattern noise and shot noise; 0 for none."""
    blur_px: float = 0.6
    """Standard deviation of the point spread function, pixel area included."""
    samples: int = 48
    """Light paths per pixel of a frame."""
    seed: int = 1
    """Seed of textures, noise and light paths."""
    threads: int = 1
    variant: str = "scalar_rgb"
    """Variant of Mitsuba."""

    def __post_init__(self) -> None:
        if self.bit_depth not in PIXEL_FORMATS:
            raise ValueError(f"bit_depth = {self.bit_depth}: wanted one of {', '.join(map(str, PIXEL_FORMATS))}")
        if not (np.isfinite(self.noise) and self.noise >= 0):
            raise ValueError(f"noise = {self.noise}: wanted a factor, 0 or more")
        grey_of(np.zeros(1), self.response)  # refuses an unknown one
        if self.frames is not None and not 1 <= self.frames <= MAX_FRAMES:
            raise ValueError(f"frames = {self.frames}: wanted 1 to {MAX_FRAMES}")
        if not MIN_SIZE_PX <= self.size_px <= MAX_SIZE_PX:
            raise ValueError(f"size_px = {self.size_px}: wanted {MIN_SIZE_PX} to {MAX_SIZE_PX}")
        if not (np.isfinite(self.start_s) and self.start_s >= 0):
            raise ValueError(f"start_s = {self.start_s}: wanted a time of 0 or more, before the first impact")
        for name in ("fps", "exposure_s"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} = {value}: wanted a finite number above 0")

    @property
    def rendering(self) -> RenderSettings:
        """Samples, threads and variant of the renderer."""
        return RenderSettings(self.samples, self.threads, self.variant)

    @property
    def sensor(self) -> Sensor:
        """The sensor with scaled noise."""
        ideal = Sensor(self.bit_depth, seed=self.seed)
        if self.noise == 0:
            return replace(
                ideal, full_well_e=NO_NOISE_WELL_E, read_noise_e=0.0, pixel_gain_sigma=0.0, pixel_offset_e=0.0
            )
        # Relative shot noise grows as the full well shrinks. Read noise and offsets are in electrons and scale with it.
        return replace(
            ideal,
            full_well_e=ideal.full_well_e / self.noise**2,
            read_noise_e=ideal.read_noise_e / self.noise,
            pixel_gain_sigma=ideal.pixel_gain_sigma * self.noise,
            pixel_offset_e=ideal.pixel_offset_e / self.noise,
        )


def response_named(text: str | None) -> Response:
    """The response that a word on the command line names: a number is an exponent. `FilmSettings` refuses unknown ones."""
    try:
        return text if text is None else float(text)
    except ValueError:
        return text


@dataclass(frozen=True, eq=False)
class _Understood:
    """The settings of a film in its provenance."""

    plan: Plan
    settings: FilmSettings
    camera: Camera


@dataclass(frozen=True, eq=False)
class FilmJob:
    """Everything that determines a clip."""

    name: str
    throw: Throw
    law: SmoothImpact | CoulombImpact
    die: Die
    camera: Camera
    surface: str
    fps: float
    exposure_s: float
    frames: int
    appearance: Appearance
    sensor: Sensor
    response: Response = None
    blur_px: float = 0.6
    rendering: RenderSettings = field(default_factory=RenderSettings)
    seed: int = 1
    """Seed of noise and light paths."""


def film(
    plan: Plan,
    out: Path,
    *,
    scene: Scene | None = None,
    settings: FilmSettings = FilmSettings(),
    force: bool = False,
    progress: Progress = lambda stage, done, total: None,
    command: tuple[str, ...] = (),
) -> FilmJob:
    """Simulate the throw of a plan and write its film to the folder `out`.

    The scene gives the camera, its rate, exposure and response, the table's surface and the marks of the die. Without a scene the
    camera is placed so that the throw stays in view. Raises SceneError for a scene without a camera or with another die,
    NoRendererError without Mitsuba, OutputExistsError if the folder exists (unless `force`). After an error no folder
    remains.
    """
    watch = Stopwatch()
    inputs = (plan.path, *((scene.path,) if scene else ()))
    with whole_folder(out, force=force, inputs=inputs) as folder:
        with watch.stage("throw"):
            job = film_job(plan, scene, settings, Path(out).name)
        with watch.stage("film"):
            write_clip(folder, job, progress)
        write_provenance(
            folder,
            command=command,
            understood=_Understood(plan, settings, job.camera),
            inputs=inputs,
            seconds=watch.seconds,
            seeds={"film": settings.seed},
        )
    return job


def film_job(plan: Plan, scene: Scene | None, settings: FilmSettings, name: str) -> FilmJob:
    """Simulate the throw and determine all settings that were left open. Raises SceneError as `film` does."""
    fps = settings.fps or (scene.clip.fps if scene and scene.clip.fps else plan.fps)
    exposure_s = settings.exposure_s or (scene.clip.exposure_s if scene else None) or min(EXPOSURE_S, 1.0 / fps)
    if exposure_s > 1.0 / fps:
        raise ValueError(f"exposure_s = {exposure_s}: wanted at most the {1.0 / fps:.4g} s between two frames")
    throw, frames = _throw_on_film(plan, fps, settings)
    times = np.arange(frames) / fps
    camera = _scene_camera(scene, plan) if scene else camera_for(throw, plan.die, times, settings.size_px)
    surface = scene.table.surface if scene else plan.table.surface
    die = replace(plan.die, marks=plan.die.marks or scene.die.marks) if scene else plan.die
    appearance = Appearance(lamp_beside(camera), seed=settings.seed)
    return FilmJob(
        name=name,
        throw=throw,
        law=plan.law,
        die=die,
        camera=camera,
        surface=surface,
        fps=fps,
        exposure_s=exposure_s,
        frames=frames,
        appearance=appearance,
        sensor=settings.sensor,
        response=settings.response if settings.response is not None or scene is None else scene.clip.response,
        blur_px=settings.blur_px,
        rendering=settings.rendering,
        seed=settings.seed,
    )


def _throw_on_film(plan: Plan, fps: float, settings: FilmSettings) -> tuple[Throw, int]:
    """The throw from the beginning of the film to its end, and the number of frames."""
    motion = plan.table.motion
    if motion is not None and motion.amplitude_m > 0:
        raise refuse(plan.path, "table.motion.amplitude_m", motion.amplitude_m, "films need a table at rest, wanted 0")
    release, frames = _release_at(plan, settings.start_s), settings.frames
    until_s = None if plan.until_s is None else plan.until_s - settings.start_s
    until = Until(time_s=until_s, impacts=plan.until_impacts)
    if frames is not None:
        until = Until(time_s=frames / fps)
    throw = throw_die(plan.die, release, plan.law, until=until).throw
    end_s = throw.flights[-1].end_s
    if until == Until():
        end_s += AFTER_LANDING_S
        throw = throw_die(plan.die, release, plan.law, until=Until(time_s=end_s)).throw
    count = frames or int(np.floor(end_s * fps + 1e-9)) + 1
    if count > MAX_FRAMES:
        wanted = f"the throw lasts {end_s:.3g} s, {count} frames; wanted at most {MAX_FRAMES}, set until.time_s"
        raise refuse(plan.path, "output.fps", fps, wanted)
    return throw, count


def _release_at(plan: Plan, start_s: float) -> State:
    """The state at the beginning of the film, as a release at time 0. Raises ValueError after the first impact."""
    if start_s == 0.0:
        return plan.release
    first = throw_die(plan.die, plan.release, plan.law, until=Until(impacts=1)).throw
    impact_s = first.impacts[0].time_s if first.impacts else first.flights[0].end_s
    if start_s >= impact_s:
        raise ValueError(f"start_s = {start_s}: wanted a time before the first impact at {impact_s:.5g} s")
    return replace(first.flights[0].at(start_s), time_s=0.0)


def _scene_camera(scene: Scene, plan: Plan) -> Camera:
    """The scene's first camera. Raises SceneError if it has none, or another die than the plan."""
    if not scene.cameras:
        raise refuse(scene.path, "camera", None, "wanted a [camera] table, whose camera films the throw")
    if scene.die.solid.name != plan.die.solid.name:
        wanted = f"the throw file has a {plan.die.solid.name}; wanted the same die in both"
        raise refuse(scene.path, "die.shape", scene.die.solid.name, wanted)
    return scene.cameras[0].camera


def camera_for(throw: Throw, die: Die, times_s: Array, size_px: int = 512) -> Camera:
    """A camera above the table that keeps the die in view from its first impact on.

    It also shows as much of the fall as possible without more than twice the distance.
    """
    first = throw.impacts[0].time_s if throw.impacts else float(times_s[-1])
    low, high = _extent(throw, die, times_s[times_s >= first] if (times_s >= first).any() else times_s)
    target = (low + high) / 2
    reach = float(np.linalg.norm(high - low)) / 2
    whole_low, whole_high = _extent(throw, die, times_s)
    wanted = min(float(np.linalg.norm(whole_high - whole_low)) / 2, 2.0 * reach)
    if wanted > reach:
        target = np.array([target[0], target[1], low[2] + wanted * (target[2] - low[2]) / reach])
        reach = wanted
    ahead = np.array([np.sin(HEADING_RAD), np.cos(HEADING_RAD), 0.0]) * np.cos(DEPRESSION_RAD)
    ahead[2] = -np.sin(DEPRESSION_RAD)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    focal = size_px / 2 / np.tan(FIELD_OF_VIEW_RAD / 2)
    middle = (size_px - 1) / 2
    matrix = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    centre = target - reach / np.tan(FIELD_OF_VIEW_RAD / 2) * ahead
    return Camera(size_px, size_px, matrix, np.zeros(5), rotation, -rotation @ centre)


def _extent(throw: Throw, die: Die, times_s: Array) -> tuple[Array, Array]:
    """The lowest and the highest corner (3,) of the box that contains the die at these times."""
    positions = throw.poses(times_s)[0]
    size = die.solid.circumradius
    return positions.min(0) - size, positions.max(0) + size


# --- writing ---


def write_clip(folder: Path, job: FilmJob, progress: Progress = lambda stage, done, total: None) -> None:
    """Write the clip with its scene, background and truth into an existing folder."""
    renderer = FilmRenderer(
        job.die, job.camera, job.surface, job.appearance, blur_px=job.blur_px, rendering=job.rendering
    )
    pattern = fixed_pattern(job.sensor, job.camera.height_px, job.camera.width_px)
    progress("Lighting the table", 0, 0)
    cv2.imwrite(str(folder / "background.png"), _background(job, pattern, renderer.empty()))
    write_ffv1(folder / "clip.avi", _frames(renderer, job, pattern, progress), job)
    (folder / "scene.toml").write_text(scene_text(job, "clip.avi"), encoding="utf-8")
    write_truth(folder, job.throw, job.die, job.camera, job.law, job.fps, job.frames)


def _frames(renderer: FilmRenderer, job: FilmJob, pattern: FixedPattern, progress: Progress) -> Iterator[NDArray]:
    """The frames as the sensor records them."""
    rng = np.random.default_rng([job.seed, 1])
    times = np.arange(job.frames) / job.fps
    for k, light in enumerate(frame_light(renderer, job.throw, times, job.exposure_s)):
        progress("Filming", k + 1, job.frames)
        yield recorded(job, expose(job.sensor, pattern, light, rng))


def _background(job: FilmJob, pattern: FixedPattern, light: Array) -> NDArray:
    """The mean of BACKGROUND_EXPOSURES exposures of the empty table."""
    rng = np.random.default_rng([job.seed, 2])
    exposures = [expose(job.sensor, pattern, light, rng) for _ in range(BACKGROUND_EXPOSURES)]
    return recorded(job, np.mean(exposures, 0))


def recorded(job: FilmJob, levels: Array) -> NDArray:
    """Whole grey levels (height, width) from those of the linear sensor, after the camera's response."""
    if not is_linear(job.response):
        top = job.sensor.top
        levels = top * grey_of(np.clip(levels / top, 0.0, 1.0), job.response)
    return rounded(job.sensor, levels)


def write_ffv1(path: Path, frames: Iterator[NDArray], job: FilmJob) -> None:
    """Write grey frames without loss, one in memory at a time."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=AVI_FPS)
        stream.height, stream.width = job.camera.height_px, job.camera.width_px
        stream.pix_fmt = PIXEL_FORMATS[job.sensor.bit_depth]
        for number, levels in enumerate(frames):
            frame = av.VideoFrame(job.camera.width_px, job.camera.height_px, stream.pix_fmt)
            lines = np.zeros((levels.shape[0], frame.planes[0].line_size // levels.itemsize), levels.dtype)
            lines[:, : levels.shape[1]] = levels
            frame.planes[0].update(lines.tobytes())
            frame.pts, frame.time_base = number, Fraction(1, AVI_FPS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def scene_text(job: FilmJob, clip: str) -> str:
    """The scene file of this clip."""
    response = "" if is_linear(job.response) else f"response = {json.dumps(job.response)}\n"
    return f"""# {job.name}: a simulated throw, rendered as filmed at {job.fps:g} frames per second.

[clip]
path = "{clip}"
fps = {float(job.fps)!r}
exposure_s = {float(job.exposure_s)!r}
background = "background.png"
{response}
{scene_tables(job.camera, job.surface, job.die)}"""


def scene_tables(camera: Camera, surface: str, die: Die) -> str:
    """The tables of a scene file that describe camera, table and die."""
    radius = f"corner_radius_m = {die.corner_radius_m!r}\n" if die.corner_radius_m else ""
    marks = f'marks = "{die.marks}"\n' if die.marks else ""
    return f"""[camera]
width = {camera.width_px}
height = {camera.height_px}
matrix = {camera.matrix.tolist()}
distortion = {camera.distortion.tolist()}
rotation = {camera.rotation.tolist()}
translation_m = {camera.translation_m.tolist()}

[table]
surface = "{surface}"

[die]
shape = "{die.solid.name}"
edge_m = {die.solid.edge_m!r}
mass_kg = {die.mass_kg!r}
{radius}{marks}"""
