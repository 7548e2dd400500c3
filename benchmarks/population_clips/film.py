"""The film of a random clip: pictures, sensor, file, scene and truth.

Each frame is rendered on a supersampled grid of the part that shows the die: the die's light and cover from rays at instants
spread over the exposure of each row, the table's light from a texture with the die's shadow. Both are blurred by the lens,
laid over each other, averaged over the pixels, and recorded by a sensor with shot noise, read noise and pixels that differ,
whose grey levels follow the response. The file is written by the codec of the draw.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diethrow.commands.model.film_truth import write_truth
from diethrow.commands.model.filmed_throw import scene_tables

from .draw import Draw
from .ray_traced_die import Body, Light, render, shadow

Array = NDArray[np.float64]

RENDERER_VERSION = 3
"""Part of the name of a cached clip; counts the changes of pictures or draws."""
FINER = 3
"""Subpixels along each side of a pixel: at a blur of 0.45 px their distance is 0.74 standard deviations."""
FINER_IF_LARGE = 2
"""The same for dice wider than LARGE_PX, for time; the blur is then above 0.9 of their distance."""
LARGE_PX = 90.0
POSES_PER_FRAME = 24
"""Poses over the exposure of a frame."""
POSES_ROLLING = 192
"""The same over readout and exposure together."""
TILE_PX = 160
TEXTURE_PX = 1024
SHADOW_LAMPS = 64
SHADOW_BLUR_PX = 0.8
"""Blur that makes one soft shadow of those of the points of a lamp."""
CONTAINER_FPS = 30
BACKGROUND_EXPOSURES = 16
PIPS = {
    1: ((0, 0),),
    2: ((-1, -1), (1, 1)),
    3: ((-1, -1), (0, 0), (1, 1)),
    4: ((-1, -1), (-1, 1), (1, -1), (1, 1)),
    5: ((-1, -1), (-1, 1), (0, 0), (1, -1), (1, 1)),
    6: ((-1, -1), (-1, 0), (-1, 1), (1, -1), (1, 0), (1, 1)),
}


def write_random_clip(draw: Draw, folder: Path) -> None:
    """Write clip, background, scene and truth of a draw into an existing folder."""
    body, light = _body(draw), _light(draw)
    rng = np.random.default_rng([draw.seed, draw.number, 1])
    size = draw.camera.width_px
    finer = FINER_IF_LARGE if _diameter_px(draw) > LARGE_PX else FINER
    rays = _rays(draw, finer)
    table, points = _table(draw, rays, np.random.default_rng([draw.seed, draw.number, 2]))
    sensor = _Sensor(draw, rng, size)
    empty = _pixels(cv2.GaussianBlur(table, (0, 0), draw.blur_px * finer, borderType=cv2.BORDER_REPLICATE), finer)
    if draw.has_background:
        exposures = np.mean([sensor.grey(empty, rng) for _ in range(BACKGROUND_EXPOSURES)], 0)
        cv2.imwrite(str(folder / "background.png"), np.rint(exposures).astype(np.uint8))
    frames = (
        np.rint(sensor.grey(light_of_frame, rng)).astype(np.uint8)
        for light_of_frame in _frames(draw, body, light, rays, points, table, empty, finer)
    )
    name = _write(folder, frames, draw)
    (folder / "scene.toml").write_text(scene_text(draw, name), encoding="utf-8")
    write_truth(folder, draw.throw, draw.die, draw.camera, draw.law, draw.fps, draw.frames)


# --- die and light ---


def _body(draw: Draw) -> Body:
    """The die for the kernels, with painted tiles."""
    solid, radius = draw.die.solid, draw.die.corner_radius_m
    rng = np.random.default_rng([draw.seed, draw.number, 3])
    normals, faces = np.asarray(solid.normals, float), solid.faces
    middles = np.array([solid.vertices[list(face)].mean(0) for face in faces])
    ups, rights, reach = [], [], 0.0
    for face, normal, middle in zip(faces, normals, middles, strict=True):
        corners = solid.vertices[list(face)]
        towards = (corners[0] + corners[1]) / 2 if len(face) == 4 else corners[0]
        up = (towards - middle) / np.linalg.norm(towards - middle)
        ups.append(up)
        rights.append(np.cross(up, normal))
        reach = max(reach, float(np.linalg.norm(corners - middle, axis=1).max()))
    inscribed = float(
        min(
            np.linalg.norm((solid.vertices[list(f)] + np.roll(solid.vertices[list(f)], -1, 0)) / 2 - m, axis=1).min()
            for f, m in zip(faces, middles, strict=True)
        )
    )
    tiles = np.stack([_tile(draw, k + 1, solid.edge_m, 1.02 * reach, inscribed, rng) for k in range(len(faces))])
    inner = solid.vertices * (1.0 - radius / solid.inradius)
    edges = np.array(solid.edges, np.int64)
    return Body(
        np.ascontiguousarray(normals),
        np.ascontiguousarray(solid.offsets, float),
        np.ascontiguousarray(inner),
        edges,
        float(radius),
        np.array(rights),
        np.array(ups),
        middles,
        1.02 * reach,
        tiles.astype(np.float32),
        draw.albedo,
    )


def _tile(draw: Draw, number: int, edge_m: float, half_m: float, inscribed_m: float, rng: np.random.Generator) -> Array:
    """The albedo of a face: its marks on the paint, with grain."""
    grain = cv2.GaussianBlur(rng.standard_normal((TILE_PX, TILE_PX)), (0, 0), 1.5)
    paint = draw.albedo * (1.0 + draw.grain * grain / grain.std())
    scale = 4
    mask = np.zeros((scale * TILE_PX, scale * TILE_PX), np.uint8)
    px_per_m = scale * TILE_PX / (2.0 * half_m)
    middle = scale * TILE_PX / 2
    if draw.die.marks == "pips":
        for a, b in PIPS[number]:
            at = (round(middle + a * 0.25 * edge_m * px_per_m), round(middle + b * 0.25 * edge_m * px_per_m))
            cv2.circle(mask, at, round(0.09 * edge_m * px_per_m), 255, -1, cv2.LINE_AA)
    elif draw.die.marks == "numbers":
        text = f"{number}." if number in (6, 9) else str(number)
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.0, 2)
        size = 1.1 * inscribed_m * px_per_m / float(np.hypot(width, height))
        thick = max(1, round(2.2 * size))
        corner = (round(middle - size * width / 2), round(middle + size * height / 2))
        cv2.putText(mask, text, corner, cv2.FONT_HERSHEY_DUPLEX, size, 255, thick, cv2.LINE_AA)
    share = cv2.resize(mask, (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA) / 255.0
    return np.asarray(paint * (1.0 - share) + draw.mark_albedo * share)


def _light(draw: Draw) -> Light:
    """Lamp and surroundings, scaled so that a face turned to the lamp has the level of the draw."""
    lamp, sky = 1.0 - draw.ambient_share, draw.ambient_share
    scale = draw.brightest / max(draw.albedo, draw.mark_albedo)
    # The reflection of a disc of radius a, widened by the roughness, with the disc's power: its radiance is the
    # irradiance over the solid angle of the lobe, in the units in which a white diffuser has its irradiance.
    width2 = 0.5 * draw.lamp_radius_rad**2 + 2.0 * draw.roughness_rad**2
    lobe = 1.0 / width2
    return Light(
        np.ascontiguousarray(draw.lamp_towards),
        scale * lamp,
        scale * sky,
        scale * sky * 0.35,
        draw.gloss,
        lobe,
        scale * lamp * 0.5 * lobe,
    )


# --- table ---


def _rays(draw: Draw, finer: int) -> Array:
    """(rows, columns, 3) unit vectors in world axes through the subpixels."""
    camera = draw.camera
    size = camera.width_px * finer
    at = (np.arange(size) + 0.5) / finer - 0.5
    u, v = np.meshgrid(at, at)
    pixels = np.stack([u.ravel(), v.ravel()], 1)[:, None]
    flat = pixels
    if camera.distortion.any():
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-9)
        flat = cv2.undistortPoints(pixels, camera.matrix, camera.distortion, P=camera.matrix, criteria=criteria)
    x = (flat[:, 0] - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
    rays = np.column_stack([x, np.ones(len(x))]) @ camera.rotation
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    return np.ascontiguousarray(rays.reshape(size, size, 3))


def _table(draw: Draw, rays: Array, rng: np.random.Generator) -> tuple[NDArray[np.float32], Array]:
    """The light of the empty table on the supersampled picture, and the points (rows, columns, 3) of it that are seen.

    Above the horizon there is a wall of one grey.
    """
    eye = draw.camera.centre_m
    down = rays[..., 2] < -0.02
    distance = np.where(down, -eye[2] / np.where(down, rays[..., 2], -1.0), 1.0)
    points = eye + distance[..., None] * rays
    points[..., 2] = 0.0
    points[~down] = np.nan
    texture = _texture(draw.surface, rng)
    # One texel covers 0.15 mm, about what a pixel sees of the table.
    texel_m = 1.5e-4
    where = np.nan_to_num(points[..., :2] / texel_m).astype(np.float32)
    tone = cv2.remap(
        texture, where[..., 0] % TEXTURE_PX, where[..., 1] % TEXTURE_PX, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    lamp, sky = (1.0 - draw.ambient_share) * draw.lamp_towards[2], draw.ambient_share
    # The lamp is near: its light falls off from a bright spot, which is what backgrounds look like.
    spot = rng.uniform(-0.05, 0.05, 2)
    fall = 1.0 / (1.0 + (np.nan_to_num(points[..., :2] - spot) ** 2).sum(-1) / 0.25**2)
    light = draw.brightest / 0.8 * tone * (lamp * fall + sky)
    light[~down] = 0.1 * draw.brightest
    return np.asarray(light, np.float32), points


def _noise(rng: np.random.Generator, sigma_x: float, sigma_y: float) -> Array:
    """Periodic smooth noise of unit variance."""
    white = rng.standard_normal((TEXTURE_PX, TEXTURE_PX))
    fy, fx = np.fft.fftfreq(TEXTURE_PX)[:, None], np.fft.rfftfreq(TEXTURE_PX)[None]
    keep = np.exp(-2.0 * np.pi**2 * ((sigma_x * fx) ** 2 + (sigma_y * fy) ** 2))
    soft = np.fft.irfft2(np.fft.rfft2(white) * keep, white.shape)
    return np.asarray(soft / soft.std())


def _texture(surface: str, rng: np.random.Generator) -> NDArray[np.float32]:
    """Albedo of the table, periodic."""
    if surface == "wood":
        rings = np.sin(2.0 * np.pi * (np.arange(TEXTURE_PX) / 64.0 + 1.2 * _noise(rng, 40.0, 300.0)))
        tone = 0.34 + 0.05 * rings + 0.02 * _noise(rng, 1.0, 20.0)
    elif surface == "cork":
        tone = 0.4 + 0.1 * _noise(rng, 5.0, 4.0) + 0.03 * _noise(rng, 1.0, 1.0)
    elif surface == "granite":
        tone = 0.14 + 0.05 * _noise(rng, 4.0, 4.0) + 0.3 * np.clip(_noise(rng, 2.0, 2.0) - 1.8, 0.0, 1.0)
    elif surface == "cloth":
        x, y = np.meshgrid(np.arange(TEXTURE_PX), np.arange(TEXTURE_PX))
        tone = 0.2 + 0.03 * np.sin(2 * np.pi * x / 8) * np.sin(2 * np.pi * y / 8) + 0.02 * _noise(rng, 2.0, 2.0)
    else:
        tone = 0.3 * (1.0 + 0.02 * _noise(rng, 1.5, 1.5) + 0.02 * _noise(rng, 60.0, 60.0))
    return np.asarray(np.clip(tone, 0.02, 0.9), np.float32)


# --- frames ---


def _diameter_px(draw: Draw) -> float:
    depth = float(np.linalg.norm(draw.throw.flights[0].start.position_m - draw.camera.centre_m))
    return float(2.0 * draw.camera.matrix[0, 0] * draw.die.solid.circumradius / depth)


def _pixels(fine: NDArray[np.float32], finer: int) -> Array:
    """Averages over the pixels."""
    rows, columns = fine.shape[0] // finer, fine.shape[1] // finer
    return np.asarray(fine.reshape(rows, finer, columns, finer).mean((1, 3)), float)


def _frames(
    draw: Draw,
    body: Body,
    light: Light,
    rays: Array,
    points: Array,
    table: NDArray[np.float32],
    empty: Array,
    finer: int,
) -> Iterator[Array]:
    """The light on the sensor, frame by frame."""
    camera, eye = draw.camera, draw.camera.centre_m
    lamps = _lamp_points(draw)
    height = camera.height_px
    row_s = draw.readout_s / max(height - 1, 1)
    blur = draw.blur_px * finer
    lamp_share = (1.0 - draw.ambient_share) * draw.lamp_towards[2]
    shade = lamp_share / (lamp_share + draw.ambient_share)
    count = POSES_ROLLING if draw.readout_s > 0 else POSES_PER_FRAME
    span_s = draw.exposure_s + draw.readout_s
    for k in range(draw.frames):
        times = k / draw.fps + ((np.arange(count) + 0.5) / count - 0.5) * span_s
        positions, rotations = _poses(draw, times)
        box = _box(draw, positions, lamps, finer)
        if box is None:
            yield empty
            continue
        (top, bottom), (left, right) = box
        rows = np.arange(top, bottom)
        middle = (((rows + 0.5) / finer - 0.5) - (height - 1) / 2) * row_s
        first = (middle - draw.exposure_s / 2 + span_s / 2) / span_s * count
        window = np.stack([first, first + draw.exposure_s / span_s * count], 1)
        moved_px = _moved_px(draw, positions, rotations) * draw.exposure_s / span_s
        samples = int(np.clip(np.ceil(moved_px / 2), 1, 6))
        part = np.ascontiguousarray(rays[top:bottom, left:right])
        die, cover = render(body, light, eye, part, rotations, positions, np.clip(window, 0, count - 1e-6), samples)
        under = table[top:bottom, left:right]
        where = points[top:bottom:finer, left:right:finer]
        dark = shadow(body, np.ascontiguousarray(where), rotations[count // 2], positions[count // 2], lamps)
        dark = _smooth_beside(dark.astype(np.float32), _pixels(cover.astype(np.float32), finer))
        dark = cv2.resize(dark, (under.shape[1], under.shape[0]), interpolation=cv2.INTER_LINEAR)
        fine = under * (1.0 - shade * dark) * (1.0 - cover.astype(np.float32)) + die.astype(np.float32)
        fine = cv2.GaussianBlur(fine, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
        full = empty.copy()
        full[top // finer : bottom // finer, left // finer : right // finer] = _pixels(fine, finer)
        yield full


def _smooth_beside(dark: NDArray[np.float32], cover: Array) -> NDArray[np.float32]:
    """A shadow, smoothed over the few points of the lamp. What lies behind the die is left out: the dark table below it would
    else show beyond its outline."""
    seen = np.asarray(1.0 - cover, np.float32)
    total = cv2.GaussianBlur(dark * seen, (0, 0), SHADOW_BLUR_PX)
    return np.asarray(total / np.maximum(cv2.GaussianBlur(seen, (0, 0), SHADOW_BLUR_PX), 1e-6), np.float32)


def _poses(draw: Draw, times_s: Array) -> tuple[Array, Array]:
    """Positions (n, 3) and rotations (n, 3, 3) of the truth."""
    positions, quaternions = draw.throw.poses(np.maximum(times_s, 0.0))
    return np.ascontiguousarray(positions), np.ascontiguousarray(
        Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    )


def _lamp_points(draw: Draw) -> Array:
    """(n, 3) unit vectors to evenly spread places on the lamp."""
    n = draw.lamp_towards
    side = np.cross(n, [1.0, 0.0, 0.0] if abs(n[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(n, side)
    k = np.arange(SHADOW_LAMPS) + 0.5
    radius, turn = draw.lamp_radius_rad * np.sqrt(k / SHADOW_LAMPS), np.pi * (1 + 5**0.5) * k
    spread = n + radius[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other)
    return np.ascontiguousarray(spread / np.linalg.norm(spread, axis=1)[:, None])


def _box(draw: Draw, positions: Array, lamps: Array, finer: int) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Rows and columns of the supersampled picture that die and shadow can change, whole pixels; None outside it."""
    camera, size = draw.camera, draw.die.solid.circumradius
    spots = [*positions[:: max(len(positions) // 8, 1)], positions[-1]]
    middle = positions[len(positions) // 2]
    reaches = [size] * len(spots)
    for lamp in lamps[:: len(lamps) // 8]:
        fall = middle - lamp * middle[2] / lamp[2]
        if np.linalg.norm(fall[:2] - middle[:2]) < 8.0 * size:
            spots.append(fall)
            reaches.append(size / lamp[2])
    pixels = camera.project(np.array(spots))
    depth = (np.array(spots) - camera.centre_m) @ camera.rotation[2]
    reach = camera.matrix[0, 0] * np.array(reaches) / depth + 6.0
    low = np.floor(np.nanmin(pixels - reach[:, None], 0)).astype(int)
    high = np.ceil(np.nanmax(pixels + reach[:, None], 0)).astype(int) + 1
    low, high = np.maximum(low, 0), np.minimum(high, camera.width_px)
    if (low >= high).any():
        return None
    return (int(low[1] * finer), int(high[1] * finer)), (int(low[0] * finer), int(high[0] * finer))


def _moved_px(draw: Draw, positions: Array, rotations: Array) -> float:
    """Longest way [px] of a corner during these poses."""
    corners = np.einsum("nij,vj->nvi", rotations[[0, -1]], draw.die.solid.vertices) + positions[[0, -1], None]
    ends = draw.camera.project(corners.reshape(-1, 3)).reshape(2, -1, 2)
    return float(np.linalg.norm(ends[1] - ends[0], axis=1).max())


# --- sensor and file ---


class _Sensor:
    """Noise and response; black level and brightest level are those of the draw."""

    def __init__(self, draw: Draw, rng: np.random.Generator, size: int) -> None:
        self.draw = draw
        self.gain = 1.0 + 0.005 * rng.standard_normal((size, size))
        self.offset_e = 0.4 * draw.read_noise_e * rng.standard_normal((size, size))

    def grey(self, light: Array, rng: np.random.Generator) -> Array:
        """Grey levels (rows, columns) before rounding, 0 to 255; light 1 fills the well."""
        draw = self.draw
        electrons = np.maximum(light, 0.0) * self.gain * draw.full_well_e
        noise_e = np.sqrt(electrons + draw.read_noise_e**2) * rng.standard_normal(light.shape)
        share = np.clip((electrons + noise_e + self.offset_e) / draw.full_well_e + draw.black_level, 0.0, 1.0)
        if draw.response == "srgb":
            share = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
        elif draw.response != "linear":
            share = share ** float(draw.response)
        return np.asarray(255.0 * share)


def _write(folder: Path, frames: Iterator[NDArray[np.uint8]], draw: Draw) -> str:
    """Write the file; its name."""
    size = draw.camera.width_px
    name = "clip.avi" if draw.codec in ("ffv1", "mjpeg") else "clip.mp4"
    codec = {"ffv1": "ffv1", "mjpeg": "mjpeg", "h264": "libx264", "hevc": "libx265"}[draw.codec]
    options = {"threads": "1"}
    if draw.codec == "h264":
        options |= {"crf": str(draw.crf), "preset": "medium"}
    elif draw.codec == "hevc":
        options |= {"x265-params": f"crf={draw.crf}:log-level=none:pools=none:frame-threads=1", "preset": "fast"}
    elif draw.codec == "mjpeg":
        options |= {"qmin": str(draw.crf), "qmax": str(draw.crf)}
    with av.open(str(folder / name), "w") as container:
        stream = container.add_stream(codec, rate=CONTAINER_FPS, options=options)
        stream.height = stream.width = size
        stream.pix_fmt = {"ffv1": "gray", "mjpeg": "yuvj420p"}.get(draw.codec, "yuv420p")
        for number, levels in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(levels, format="gray")
            if stream.pix_fmt != "gray":
                frame = frame.reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = number, Fraction(1, CONTAINER_FPS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return name


def scene_text(draw: Draw, clip: str) -> str:
    """The scene file that a user would write who knows the camera exactly."""
    background = 'background = "background.png"\n' if draw.has_background else ""
    response = f"response = {json.dumps(draw.response)}\n" if draw.states_response else ""
    readout = f"readout_s = {draw.readout_s!r}\n" if draw.readout_s else ""
    return f"""# Clip {draw.number} of seed {draw.seed}: {", ".join(draw.kinds)}.

[clip]
path = "{clip}"
fps = {draw.fps!r}
fps_sigma = 0.0
exposure_s = {draw.exposure_s!r}
{background}{readout}{response}
{scene_tables(draw.camera, draw.surface, draw.die)}"""
