"""The samples hold what their README says."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from diethrow.model.rotations import rotate
from diethrow.tracking.background import load_background
from diethrow.tracking.camera import Camera
from diethrow.tracking.clip import Clip, open_clip

ROOT = Path(__file__).parents[2]
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
    truth, body = pd.read_csv(TRUTH / "truth.csv"), pd.read_csv(TRUTH / "vertices.csv")[["x", "y", "z"]].to_numpy()
    for k in (95 - first, 110 - first, 125 - first):
        row = truth.iloc[k + first]
        vertices = rotate(row[["qw", "qx", "qy", "qz"]].to_numpy(float), body)
        vertices_px = camera.project(vertices + row[["x", "y", "z"]].to_numpy(float))
        changed = np.abs(clip.frame(k) - background) > 40 * 2 ** (bits - 8)
        inside = _inside_hull(vertices_px, clip.width_px, clip.height_px)
        # Faces and pips that happen to be as bright as the wood do not show; shadows stay below the threshold.
        assert changed[inside].mean() > 0.6
        assert changed[~inside].mean() < 0.1
        centre = np.argwhere(changed & inside).mean(axis=0)[::-1]
        assert np.linalg.norm(centre - vertices_px.mean(axis=0)) < 12.0  # a tenth of the die's width


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


def _inside_hull(points_px: np.ndarray, width: int, height: int) -> np.ndarray:
    import cv2

    mask = np.zeros((height, width), np.uint8)
    hull = cv2.convexHull(points_px.astype(np.float32)).round().astype(np.int32)
    cv2.fillConvexPoly(mask, hull, 1)
    return mask.astype(bool)
