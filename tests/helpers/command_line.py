"""Commands as a user types them, and the text and footage of the scenes that their tests read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from typer.testing import CliRunner

from diethrow.cli.app import app

CUBE = '[die]\nshape = "cube"\nedge_m = 0.016\nmass_kg = 0.0048\n'
CUBE_ON_WOOD = f'[table]\nsurface = "wood"\n{CUBE}'
LAW = "[law]\nchi = 0.5\n"
RELEASE = """\
[initial]
position_m = [0.0, 0.0, 0.06]
euler_rad = [0.1, 0.7, -0.4]
velocity_m_s = [0.3, 0.1, -0.4]
omega_body_rad_s = [9.0, 30.0, 4.0]
"""
SMALL_CAMERA = """\
[camera]
width = 96
height = 64
matrix = [[700.0, 0.0, 47.5], [0.0, 700.0, 31.5], [0.0, 0.0, 1.0]]
rotation = [[1.0, 0.0, 0.0], [0.0, -0.6, -0.8], [0.0, 0.8, -0.6]]
translation_m = [0.0, 0.02, 0.6]
"""


def invoke(*words: object, answers: str | None = None) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a command; `answers` are what a user types."""
    result = CliRunner().invoke(app, [str(word) for word in words], input=answers)
    assert "Traceback" not in result.output
    return result.exit_code, result.stdout, result.stderr


def text_file(path: Path, text: str) -> Path:
    """The path, after the text is written to it."""
    path.write_text(text, encoding="utf-8")
    return path


def empty_table(seed: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The background, and thirty frames of an empty table with sensor noise, as SMALL_CAMERA sees them."""
    ground = np.tile(np.linspace(60, 160, 96), (64, 1))
    noise = np.random.default_rng(seed).normal(0, 2, (30, 64, 96))
    return ground.round().astype(np.uint8), (ground + noise).round().astype(np.uint8)
