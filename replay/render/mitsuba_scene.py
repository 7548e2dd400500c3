"""The set of a film, in Mitsuba's terms: die, table, lamp, room and camera.

**Mirror.** A reflecting table is a window into the mirrored scene: image die, image lamp and image room below it, seen
and shining through a film that lets `REFLECTANCE` pass (method of images). That is exact for a plane, and free of the
sparks that a path tracer makes of lamp light that reaches the die by way of a mirror.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...tracking.camera import Camera
from .die_surface import Mesh, die_mesh, face_paint
from .image_boxes import Box
from .lens import Optics
from .table_textures import WIDTH_M, is_mirror, table_paint

Array = NDArray[np.float64]
Point = tuple[float, float, float]

UPSIDE_DOWN = np.array([1.0, 1.0, -1.0])
TABLE_HALF_M = 2.0
REFLECTANCE = 0.8
"""Of a mirror table, where no dust lies: a front-coated one has 0.9, a glass one less."""
DEPTH = 5
"""Of the light paths: lamp, table, die, table, eye."""


@dataclass(frozen=True)
class Appearance:
    """The scene but for die, table and camera: paint, lamp, and what stands in front."""

    lamp_m: Point
    """Middle of the square lamp, which faces the origin; world."""
    lamp_side_m: float = 0.08
    fill: float = 0.25
    """Light of the room, as a part of the lamp's at the origin."""
    paint: float = 0.75
    """Reflectance of the die."""
    ink: float = 0.03
    """Reflectance of its marks."""
    roughness: float = 0.15
    """Of its gloss: 0.05 a mirror's, 0.5 dull."""
    grain: float = 0.015
    """Relative standard deviation of the die's paint."""
    table_tone: float = 1.0
    """Factor on the reflectance of the table."""
    brightest: float = 0.8
    """Part of the sensor's range that a face turned to the lamp fills, gloss apart."""
    rods_m: tuple[tuple[Point, Point, float], ...] = ()
    """Rods in the picture: both ends and the radius, world."""
    seed: int = 1
    """Of the table's texture and the paint's grain."""


def lamp_beside(camera: Camera, distance_m: float = 0.6) -> Point:
    """A place for the lamp, 50 degrees high and 55 degrees to the left of the camera: three faces get three shades."""
    away = camera.centre_m[:2] / max(float(np.linalg.norm(camera.centre_m[:2])), 1e-9)
    turn, rise = np.radians(-55.0), np.radians(50.0)
    across = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ away
    x, y = distance_m * np.cos(rise) * across
    return float(x), float(y), float(distance_m * np.sin(rise))


def scene_of(mi: Any, die: Die, optics: Optics, surface: str, look: Appearance) -> dict[str, Any]:
    """Everything, as Mitsuba's dictionary."""
    paint = face_paint(die, paint=look.paint, ink=look.ink, grain=look.grain, seed=look.seed)
    coat = mi.load_dict({"type": "roughplastic", "alpha": look.roughness, "diffuse_reflectance": _picture(mi, paint)})
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH},
        "sensor": _sensor(mi, optics),
        "table": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(TABLE_HALF_M),
            "bsdf": _table_coat(mi, surface, look),
        },
        "lamp": _lamp(mi, look.lamp_m, look.lamp_side_m),
        "room": _room_light(mi, surface, look),
        "body": {"type": "shapegroup", "skin": _mesh(mi, die_mesh(die), coat)},
        "die": {"type": "instance", "to_world": mi.ScalarTransform4f(), "of": {"type": "ref", "id": "body"}},
    }
    for k, rod in enumerate(look.rods_m):
        scene[f"rod_{k}"] = _rod(*rod)
    if is_mirror(surface):
        mesh = die_mesh(die)
        flipped = Mesh(mesh.vertices_m * UPSIDE_DOWN, mesh.normals * UPSIDE_DOWN, mesh.places, mesh.triangles[:, ::-1])
        x, y, z = look.lamp_m
        scene["integrator"] = {"type": "volpath", "max_depth": DEPTH}
        scene["image_lamp"] = _lamp(mi, (x, y, -z), look.lamp_side_m)
        scene["image_body"] = {"type": "shapegroup", "skin": _mesh(mi, flipped, coat)}
        scene["image"] = {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(),
            "of": {"type": "ref", "id": "image_body"},
        }
        for k, (begin, end, radius) in enumerate(look.rods_m):
            down = tuple(np.array(begin) * UPSIDE_DOWN), tuple(np.array(end) * UPSIDE_DOWN)
            scene[f"image_rod_{k}"] = _rod(*down, radius)
    return scene


def _rod(begin: Point, end: Point, radius: float) -> dict[str, Any]:
    coat = {"type": "twosided", "coat": {"type": "diffuse", "reflectance": _grey(0.2)}}
    return {"type": "cylinder", "p0": list(begin), "p1": list(end), "radius": radius, "bsdf": coat}


def _sensor(mi: Any, optics: Optics) -> dict[str, Any]:
    axes = sensor_axes(optics, (0, 0, optics.width_px, optics.height_px))
    axes["fov"] = axes.pop("x_fov")
    return axes | {
        "type": "perspective",
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(optics.pose),
        "film": {
            "type": "hdrfilm",
            "width": optics.width_px,
            "height": optics.height_px,
            "pixel_format": "luminance",
            "rfilter": {"type": "gaussian", "stddev": optics.filter_px},
        },
        "sampler": {"type": "multijitter"},
    }


def sensor_axes(optics: Optics, box: Box) -> dict[str, Any]:
    """Field of view [deg] and principal point of the ideal camera that shows a box of the ideal picture."""
    left, top, right, bottom = box
    return {
        "x_fov": float(np.degrees(2.0 * np.arctan((right - left) / 2.0 / optics.focal_px))),
        # Mitsuba's offsets are parts of the picture, to the left and up, from its middle; its pixel centres are at 0.5.
        "principal_point_offset_x": 0.5 - (optics.middle_px[0] - left + 0.5) / (right - left),
        "principal_point_offset_y": 0.5 - (optics.middle_px[1] - top + 0.5) / (bottom - top),
    }


def _lamp(mi: Any, middle: Point, side: float) -> dict[str, Any]:
    """A square that faces the origin and lights it with irradiance 1."""
    place = mi.ScalarTransform4f().look_at(origin=list(middle), target=[0, 0, 0], up=[0, 0, 1])
    return {
        "type": "rectangle",
        "to_world": place @ mi.ScalarTransform4f().scale(side / 2),
        "emitter": {"type": "area", "radiance": _grey(float(np.linalg.norm(middle)) ** 2 / side**2)},
    }


def _room_light(mi: Any, surface: str, look: Appearance) -> dict[str, Any]:
    """Even light from all sides; round a mirror, which shows it, a room with things in it."""
    radiance = look.fill / np.pi
    if not is_mirror(surface):
        return {"type": "constant", "radiance": _grey(radiance)}
    rng = np.random.default_rng(look.seed + 1)
    above = np.full((256, 1024), 0.4, np.float32)  # three pixels a degree, zenith to horizon
    for _ in range(500):
        row, column = rng.integers(0, 256), rng.integers(0, 1024)
        high, wide = rng.integers(6, 40, 2)
        above[row : row + high, column : column + wide] = rng.choice([0.15, 0.4, 1.0, 2.0])
    above = cv2.GaussianBlur(above, (0, 0), 2.0)  # out of focus
    room = np.concatenate([above, above[::-1]]) * (radiance / above.mean())
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(np.repeat(room[..., None], 3, 2), np.float32)),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90.0),
    }


def _table_coat(mi: Any, surface: str, look: Appearance) -> dict[str, Any]:
    scale = mi.ScalarTransform4f().scale(2.0 * TABLE_HALF_M / WIDTH_M)
    shift = mi.ScalarTransform4f().translate([0.5, 0.5, 0.0])
    # The rectangle's own coordinates run from 0 to 1; the texture's middle is to lie at the origin.
    to_uv = shift @ scale @ mi.ScalarTransform4f().translate([-0.5, -0.5, 0.0])
    paint = table_paint(surface, look.seed)
    if is_mirror(surface):
        film = _picture(mi, np.asarray(1.0 - REFLECTANCE * (1.0 - paint), np.float32), to_uv)
        return {"type": "mask", "opacity": film, "dust": {"type": "diffuse", "reflectance": _picture(mi, paint, to_uv)}}
    paint = np.asarray(np.clip(look.table_tone * paint, 0.0, 0.95), np.float32)
    if "cork" in surface.lower():
        return {"type": "diffuse", "reflectance": _picture(mi, paint, to_uv)}
    return {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": _picture(mi, paint, to_uv)}


def _picture(mi: Any, levels: NDArray[np.float32], to_uv: Any = None) -> dict[str, Any]:
    texture = {"type": "bitmap", "data": mi.TensorXf(np.ascontiguousarray(levels[..., None])), "raw": True}
    return texture | ({"to_uv": to_uv} if to_uv is not None else {})


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": float(value)}


def _mesh(mi: Any, mesh: Mesh, coat: Any) -> Any:
    properties = mi.Properties()
    properties["mesh_bsdf"] = coat
    shape = mi.Mesh(
        "skin",
        len(mesh.vertices_m),
        len(mesh.triangles),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    handles = mi.traverse(shape)
    for name, values in (
        ("vertex_positions", mesh.vertices_m),
        ("vertex_normals", mesh.normals),
        ("vertex_texcoords", mesh.places),
        ("faces", mesh.triangles),
    ):
        kind = np.uint32 if name == "faces" else np.float32
        handles[name] = type(handles[name])(np.ascontiguousarray(values, kind).ravel())
    handles.update()
    return shape
