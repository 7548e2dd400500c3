"""The samples hold what their README says."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from diethrow.files.csv_and_json import read_table
from diethrow.model.rotations import matrix_from_quat
from diethrow.tracking.camera import Camera
from diethrow.tracking.footage.background import load_background
from diethrow.tracking.footage.clip import Clip, open_clip

ROOT = Path(__file__).parents[3]
TRUTH = ROOT / "tests" / "data" / "cube_wood"


def _scene(name: str) -> tuple[Clip, Camera, np.ndarray]:
    folder = ROOT / "data_samples" / name
    scene = tomllib.loads((folder / "scene.toml").read_text())
    clip = open_clip(folder / scene["clip"]["path"], fps=scene["clip"]["fps"])
    c = scene["camera"]
    arrays = (np.array(c[key]) for key in ("matrix", "distortion", "rotation", "translation_m"))
    camera = Camera(c["width"], c["height"], *arrays)
    return clip, camera, load_background(folder / scene["clip"]["background"], clip)


@pytest.mark.parametrize(
    ("name", "count", "bits", "first"), [("cube_wood", 260, 8, 0), ("cube_wood_photron", 40, 12, 90)]
)
def test_the_die_of_each_sample_is_where_the_truth_projects_it(name: str, count: int, bits: int, first: int) -> None:
    clip, camera, background = _scene(name)
    assert (len(clip), clip.bit_depth, clip.notices) == (count, bits, ())
    assert (camera.width_px, camera.height_px) == (clip.width_px, clip.height_px)
    truth = read_table(TRUTH / "truth.csv", ("frame",)).numbers(("qw", "qx", "qy", "qz", "x", "y", "z"))
    body = read_table(TRUTH / "vertices.csv", ("vertex",)).numbers(("x", "y", "z"))
    for k in (95 - first, 110 - first, 125 - first):
        quaternion, position = truth[k + first, :4], truth[k + first, 4:]
        vertices_px = camera.project(body @ matrix_from_quat(quaternion).T + position)
        contour_px = cv2.convexHull(vertices_px.astype(np.float32))[:, 0]
        change = np.abs(clip.frame(k) - background) / 2 ** (bits - 8)
        there, *joint_covariance = (
            _mean_slope_along(contour_px + s, change) for s in ((0, 0), (6, 0), (-6, 0), (0, 6), (0, -6))
        )
        # The contour is an edge of the picture at its own place, and at none that lies 6 px (a blur and a half) away.
        assert there > 1.5 * max(joint_covariance)


def test_the_two_samples_are_one_throw() -> None:
    film, _, _ = _scene("cube_wood")
    photron, _, _ = _scene("cube_wood_photron")
    error = film.frame(110)[136:352, 86:238].astype(float) - photron.frame(20) / 16.0
    assert abs(error.mean()) < 0.3  # the film lost no level
    assert error.std() < 2.0  # its error is that of the sensor's noise, 1.3


def test_the_samples_are_small_enough_to_clone() -> None:
    sizes = {f.parent.name: 0 for f in (ROOT / "data_samples").glob("*/*")}
    for file in (ROOT / "data_samples").glob("*/*"):
        sizes[file.parent.name] += file.stat().st_size
    assert sizes["cube_wood"] <= 3e6
    assert sizes["cube_wood_photron"] <= 2.5e6


def _mean_slope_along(contour_px: np.ndarray, picture: np.ndarray) -> float:
    """Mean gradient of a picture [grey levels per px] on a closed contour (n, 2)."""
    slope = np.hypot(*(cv2.Sobel(picture, cv2.CV_64F, *order) / 8.0 for order in ((1, 0), (0, 1))))
    on_contour = np.zeros(picture.shape, np.uint8)
    cv2.polylines(on_contour, [contour_px.round().astype(np.int32)], isClosed=True, color=1, thickness=2)
    return float(slope[on_contour > 0].mean())
