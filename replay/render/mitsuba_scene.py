"""The scene of a film as Mitsuba's dictionary: die, table, lamp, room and camera.

**Mirror.** A reflecting table is a window into the mirrored scene (method of images). The image die, the image lamp and the
image room lie below it, and a film on the table transmits `REFLECTANCE` of their light. This is exact for a plane. A path
tracer would render lamp light that reaches the die by a mirror as isolated bright pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...tracking.camera import Camera
from .die_surface import Mesh, die_mesh, face_paint, mark_heights, stretched
from .image_boxes import Box
from .lens import Optics
from .table_textures import WIDTH_M, is_mirror, table_paint

Array = NDArray[np.float64]
Point = tuple[float, float, float]

MIRRORED_Z = np.array([1.0, 1.0, -1.0])
"""Factors that map a point to its image in the table."""
TABLE_HALF_M = 2.0
"""Half the side of the rendered table."""
REFLECTANCE = 0.8
"""Reflectance of a mirror table without dust: a front-coated mirror has 0.9, a glass one less."""
MAX_PATH_DEPTH = 5
"""Vertices of the longest light path: lamp, table, die, table, camera."""
TRANSLUCENT_PATH_DEPTH = 10
"""The same through a die: into it, reflected within it, and out."""
PLASTIC_INDEX = 1.49
"""Refractive index of acrylic."""
TABLE_ROUGHNESS = 0.3
ROD_REFLECTANCE = 0.2
MAX_REFLECTANCE = 0.95
"""Of a table, after its factor."""
LAMP_TURN_RAD = np.radians(-55.0)
"""Direction of the lamp from that of the camera: the three visible faces of a die then have three shades."""
LAMP_ELEVATION_RAD = np.radians(50.0)


@dataclass(frozen=True)
class Appearance:
    """The scene apart from die, table and camera: lamp, reflectances, and rods in front of the die."""

    lamp_m: Point
    """Centre of the square lamp, which faces the origin, in world coordinates."""
    lamp_side_m: float = 0.08
    room_light: float = 0.25
    """Irradiance by the room, as a share of that by the lamp at the origin."""
    die_reflectance: float = 0.75
    mark_reflectance: float = 0.03
    roughness: float = 0.15
    """Roughness of the die's gloss: 0.05 is nearly a mirror, 0.5 is dull."""
    grain: float = 0.015
    """Relative standard deviation of the die's reflectance."""
    speckle: float = 0.0
    """Share of the faces that dark flakes cover."""
    translucency: float = 0.0
    """Share of the surface's light that is refracted through the die; the rest is scattered by the paint."""
    mark_depth_m: float = 0.0
    """Depth of recessed marks."""
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors on the body axes of the die that is seen, for dice whose edges are not equal."""
    table_factor: float = 1.0
    """Factor on the reflectance of the table."""
    lit_face_level: float = 0.8
    """Share of the sensor's range on a face that is turned to the lamp, without gloss."""
    rods_m: tuple[tuple[Point, Point, float], ...] = ()
    """Rods in the image: both ends and the radius, in world coordinates."""
    seed: int = 1
    """Seed of the table's texture and of the grain."""


def lamp_beside(camera: Camera, distance_m: float = 0.6) -> Point:
    """A position for the lamp: 50 degrees above the table, 55 degrees to the left of the camera."""
    away = camera.centre_m[:2] / max(float(np.linalg.norm(camera.centre_m[:2])), 1e-9)
    turn, rise = LAMP_TURN_RAD, LAMP_ELEVATION_RAD
    across = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ away
    x, y = distance_m * np.cos(rise) * across
    return float(x), float(y), float(distance_m * np.sin(rise))


def scene_of(mi: Any, die: Die, optics: Optics, surface: str, appearance: Appearance, dice: int = 1) -> dict[str, Any]:
    """The whole scene as Mitsuba's dictionary, with equal dice `die_0`, `die_1`, … and on a mirror their images `image_0`, …"""
    coat, mesh = _die_coat(mi, die, appearance), stretched(die_mesh(die), appearance.stretch)
    depth = TRANSLUCENT_PATH_DEPTH if appearance.translucency > 0 else MAX_PATH_DEPTH
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth},
        "sensor": _sensor(mi, optics),
        "table": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(TABLE_HALF_M),
            "bsdf": _table_coat(mi, surface, appearance),
        },
        "lamp": _lamp(mi, appearance.lamp_m, appearance.lamp_side_m),
        "room": _room_light(mi, surface, appearance),
        "body": {"type": "shapegroup", "skin": _mesh(mi, mesh, coat)},
    }
    scene |= {f"die_{k}": _instance(mi, "body") for k in range(dice)}
    for k, rod in enumerate(appearance.rods_m):
        scene[f"rod_{k}"] = _rod(*rod)
    if is_mirror(surface):
        flipped = Mesh(
            mesh.vertices_m * MIRRORED_Z, mesh.normals * MIRRORED_Z, mesh.texture_uv, mesh.triangles[:, ::-1]
        )
        x, y, z = appearance.lamp_m
        scene["integrator"] = {"type": "volpath", "max_depth": depth}
        scene["image_lamp"] = _lamp(mi, (x, y, -z), appearance.lamp_side_m)
        scene["image_body"] = {"type": "shapegroup", "skin": _mesh(mi, flipped, coat)}
        scene |= {f"image_{k}": _instance(mi, "image_body") for k in range(dice)}
        for k, (begin, end, radius) in enumerate(appearance.rods_m):
            down = tuple(np.array(begin) * MIRRORED_Z), tuple(np.array(end) * MIRRORED_Z)
            scene[f"image_rod_{k}"] = _rod(*down, radius)
    return scene


def _die_coat(mi: Any, die: Die, appearance: Appearance) -> Any:
    """The surface of the die: paint under a clear coat, with recesses, and partly transparent."""
    paint = face_paint(
        die,
        die_reflectance=appearance.die_reflectance,
        mark_reflectance=appearance.mark_reflectance,
        grain=appearance.grain,
        seed=appearance.seed,
        speckle=appearance.speckle,
    )
    coat: dict[str, Any] = {
        "type": "roughplastic",
        "alpha": appearance.roughness,
        "diffuse_reflectance": _picture(mi, paint),
    }
    if appearance.mark_depth_m > 0:
        coat = {
            "type": "bumpmap",
            "heights": _picture(mi, mark_heights(die, appearance.mark_depth_m)),
            "coat": coat,
        }
    if appearance.translucency > 0:
        body = {"type": "roughdielectric", "alpha": appearance.roughness, "int_ior": PLASTIC_INDEX}
        coat = {"type": "blendbsdf", "weight": appearance.translucency, "coat": coat, "inside": body}
    return mi.load_dict(coat)


def _instance(mi: Any, body: str) -> dict[str, Any]:
    return {"type": "instance", "to_world": mi.ScalarTransform4f(), "of": {"type": "ref", "id": body}}


def _rod(begin: Point, end: Point, radius: float) -> dict[str, Any]:
    coat = {"type": "twosided", "coat": {"type": "diffuse", "reflectance": _grey(ROD_REFLECTANCE)}}
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
    """Field of view [deg] and principal point of the ideal camera that shows a box of the ideal image."""
    left, top, right, bottom = box
    return {
        "x_fov": float(np.degrees(2.0 * np.arctan((right - left) / 2.0 / optics.focal_px))),
        # Mitsuba's offsets are shares of the image, to the left and up from its centre; its pixel centres are at 0.5.
        "principal_point_offset_x": 0.5 - (optics.middle_px[0] - left + 0.5) / (right - left),
        "principal_point_offset_y": 0.5 - (optics.middle_px[1] - top + 0.5) / (bottom - top),
    }


def _lamp(mi: Any, middle: Point, side: float) -> dict[str, Any]:
    """A square lamp that faces the origin and gives it an irradiance of 1."""
    place = mi.ScalarTransform4f().look_at(origin=list(middle), target=[0, 0, 0], up=[0, 0, 1])
    return {
        "type": "rectangle",
        "to_world": place @ mi.ScalarTransform4f().scale(side / 2),
        "emitter": {"type": "area", "radiance": _grey(float(np.linalg.norm(middle)) ** 2 / side**2)},
    }


def _room_light(mi: Any, surface: str, appearance: Appearance) -> dict[str, Any]:
    """Uniform light from all sides; with a mirror, which shows the room, an environment of dark and bright areas."""
    radiance = appearance.room_light / np.pi
    if not is_mirror(surface):
        return {"type": "constant", "radiance": _grey(radiance)}
    rng = np.random.default_rng(appearance.seed + 1)
    above = np.full((256, 1024), 0.4, np.float32)  # three pixels per degree, zenith to horizon
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


def _table_coat(mi: Any, surface: str, appearance: Appearance) -> dict[str, Any]:
    scale = mi.ScalarTransform4f().scale(2.0 * TABLE_HALF_M / WIDTH_M)
    shift = mi.ScalarTransform4f().translate([0.5, 0.5, 0.0])
    # The rectangle's own coordinates run from 0 to 1; the centre of the texture must lie at the origin.
    to_uv = shift @ scale @ mi.ScalarTransform4f().translate([-0.5, -0.5, 0.0])
    paint = table_paint(surface, appearance.seed)
    if is_mirror(surface):
        film = _picture(mi, np.asarray(1.0 - REFLECTANCE * (1.0 - paint), np.float32), to_uv)
        return {"type": "mask", "opacity": film, "dust": {"type": "diffuse", "reflectance": _picture(mi, paint, to_uv)}}
    paint = np.asarray(np.clip(appearance.table_factor * paint, 0.0, MAX_REFLECTANCE), np.float32)
    if "cork" in surface.lower():
        return {"type": "diffuse", "reflectance": _picture(mi, paint, to_uv)}
    return {"type": "roughplastic", "alpha": TABLE_ROUGHNESS, "diffuse_reflectance": _picture(mi, paint, to_uv)}


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
        ("vertex_texcoords", mesh.texture_uv),
        ("faces", mesh.triangles),
    ):
        kind = np.uint32 if name == "faces" else np.float32
        handles[name] = type(handles[name])(np.ascontiguousarray(values, kind).ravel())
    handles.update()
    return shape
