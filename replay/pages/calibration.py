"""The page of a calibration: the camera with its standard errors, the residuals of every corner, and the table's board."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...tracking.calibration import INTRINSICS, Calibration, PosedBoard, TablePose
from ..elements import AXIS_COLOURS, IMPACT, MEASURED, SIMULATED, hex_colour
from .matplotlib_figures import as_address, captioned_plot, drawing
from .page_parts import WIDE, as_table, captioned, image, whole_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE, GREY = hex_colour(MEASURED), hex_colour(SIMULATED), hex_colour(IMPACT)
ARROW_PERCENTILE = 95
"""Percentile of the residuals that sets the scale of the arrows, so that an outlier does not shrink the others."""
ARROW_SHARE = 0.06
"""Length of the arrow of a residual at that percentile, as a share of the image width."""
CIRCLE_SIGMAS = 2.0
"""Radius of the circle in the plot of residuals, in standard errors of a coordinate."""
AXIS_SQUARES = 2.0
"""Length of the drawn world axes, in squares of the board."""
NAME_CHARACTERS = 24
"""Characters of a file name, from its end, that fit below a bar."""

SCATTER_CAPTION = "Found minus projected position, one dot per corner. The circle has a radius of two standard errors."
IMAGES_CAPTION = "Root mean square residual of the corners of each image; orange: image not used."
DISTORTION_CAPTION = (
    "Radial displacement of a point by the lens, relative to a pinhole camera, from the image centre to its farthest "
    "corner. Grey: the range of the boards' corners."
)


def calibration_page(
    calibration: Calibration, table: TablePose | None, table_picture: NDArray[np.uint8] | None, square_m: float
) -> str:
    """The page as HTML; `table_picture` (height, width) is the image of the board on the table, `square_m` [m] its square."""
    parts = [
        "<h1>Camera calibration</h1>",
        f'<p class="key">{len(calibration.boards)} images of {calibration.width_px} × {calibration.height_px} px</p>',
        _verdict(calibration, table),
        "<h2>Camera</h2>",
        _camera(calibration),
        "<h2>Residuals</h2>",
        _arrows(calibration),
        captioned_plot((5.2, 4.4), lambda ax: _scatter(ax, calibration), SCATTER_CAPTION, narrow=True),
        captioned_plot((WIDE, 2.6), lambda ax: _image_residuals(ax, calibration), IMAGES_CAPTION),
        captioned_plot((WIDE, 2.4), lambda ax: _distortion(ax, calibration), DISTORTION_CAPTION),
        _table(table, table_picture, square_m),
        _notes(calibration),
    ]
    return whole_page("Camera calibration", parts)


def _verdict(calibration: Calibration, table: TablePose | None) -> str:
    K, sigmas = calibration.matrix, calibration.sigmas
    sentences = [
        f"The found corners differ from the projected ones by {calibration.rms_px:.3g} px, root mean square.",
        f"The focal length is {K[0, 0]:.6g} ± {sigmas[0]:.2g} px.",
    ]
    if table is not None:
        centre = table.camera.centre_m
        down = np.degrees(np.arcsin(table.camera.rotation[2, 2] * -1.0))
        sentences.append(
            f"The camera is {1e3 * centre[2]:.4g} mm above the table and points {down:.3g}° downwards; "
            f"the standard error of the vertical is {np.degrees(table.tilt_sigma_rad):.2g}°."
        )
    text = " ".join(escape(sentence) for sentence in sentences)
    headline = "Camera and table" if table is not None else "Camera only: no image of a board on the table was given"
    return f'<div class="verdict"><p class="headline">{headline}</p><p>{text}</p></div>'


def _camera(calibration: Calibration) -> str:
    units = ("px",) * 4 + ("1",) * 5
    rows = []
    for name, unit, value, sigma in zip(INTRINSICS, units, calibration.values, calibration.sigmas, strict=True):
        fitted = name in calibration.free
        rows.append(
            (
                f"{name} [{unit}]",
                f"{value:.6g}" if fitted else "0",
                f"{sigma:.2g}" if fitted else "held at 0: the corners do not need it",
            )
        )
    return as_table(("", "value", "standard error"), rows)


def _arrows(calibration: Calibration) -> str:
    """Every residual as an arrow at its corner, magnified by one factor, with the caption."""
    seen = np.concatenate([board.view.pixels for board in calibration.boards])
    off = np.concatenate([board.residuals_px for board in calibration.boards])
    usual = max(float(np.percentile(np.linalg.norm(off, axis=1), ARROW_PERCENTILE)), 1e-6)
    times = ARROW_SHARE * calibration.width_px / usual
    with drawing((WIDE, WIDE * calibration.height_px / calibration.width_px)) as figure:
        ax = figure.subplots()
        ax.quiver(*seen.T, *(times * off).T, angles="xy", scale_units="xy", scale=1, width=0.0015, color=BLUE)
        ax.set(
            xlim=(0, calibration.width_px),
            ylim=(calibration.height_px, 0),
            aspect="equal",
            xlabel="x [px]",
            ylabel="y [px]",
        )
        address = as_address(figure, "svg")
    caption = (
        f"Found minus projected position, magnified {times:.0f} times. Arrows with a common direction in a region indicate a "
        "lens that the model does not describe, or a board that is not flat."
    )
    return captioned(image(address, caption), caption)


def _scatter(ax: Axes, calibration: Calibration) -> Axes:
    off = np.concatenate([board.residuals_px for board in calibration.boards])
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    ax.plot(*off.T, ".", color=BLUE, markersize=3)
    radius = CIRCLE_SIGMAS * calibration.sigma_px
    ax.plot(radius * np.cos(turn), radius * np.sin(turn), color=GREY, lw=1)
    ax.set(aspect="equal", xlabel="Δx [px]", ylabel="Δy [px]")
    return ax


def _image_residuals(ax: Axes, calibration: Calibration) -> Axes:
    names = [board.view.name for board in calibration.boards] + [name for name, _ in calibration.left_out]
    values = [board.rms_px for board in calibration.boards] + [rms for _, rms in calibration.left_out]
    colours = [BLUE] * len(calibration.boards) + [ORANGE] * len(calibration.left_out)
    ax.bar(range(len(names)), values, color=colours)
    ax.set_xticks(range(len(names)), [name[-NAME_CHARACTERS:] for name in names], rotation=90, fontsize=6.5)
    ax.set(ylabel="RMS [px]")
    return ax


def _distortion(ax: Axes, calibration: Calibration) -> Axes:
    K, (k1, k2, _, _, k3) = calibration.matrix, calibration.distortion
    corners = np.array([(x, y) for x in (0, calibration.width_px) for y in (0, calibration.height_px)])
    far = np.linalg.norm((corners - K[:2, 2]) / np.diag(K)[:2], axis=1)
    r = np.linspace(0.0, float(far.max()), 200)
    ax.plot(K[0, 0] * r, K[0, 0] * r * (k1 * r**2 + k2 * r**4 + k3 * r**6), color=BLUE)
    seen = np.concatenate([board.view.pixels for board in calibration.boards]) - K[:2, 2]
    reach = np.linalg.norm(seen, axis=1)
    ax.axvspan(float(reach.min()), float(reach.max()), color=GREY, alpha=0.15, lw=0)
    ax.set(xlabel="distance from the centre [px]", ylabel="radial shift [px]")
    return ax


def _table(table: TablePose | None, picture: NDArray[np.uint8] | None, square_m: float) -> str:
    if table is None or picture is None:
        return ""
    alternative = "The plane has no second pose."
    if table.other_rms_px is not None:
        alternative = (
            f"This pose leaves {table.board.rms_px:.3g} px (RMS), the plane's other pose {table.other_rms_px:.3g} px."
        )
    caption = (
        "The board on the table: found corners (blue circles), projected corners (orange crosses), and the world axes "
        f"x, y and z (red, green, violet). {alternative}"
    )
    rows = []
    centre, sigmas = table.camera.centre_m, np.sqrt(np.diag(table.covariance))
    rows.append(("position of the camera [mm]", ", ".join(f"{1e3 * x:.5g}" for x in centre), ""))
    rows.append(
        (
            "translation_m [mm]",
            ", ".join(f"{1e3 * x:.5g}" for x in table.camera.translation_m),
            ", ".join(f"{1e3 * s:.2g}" for s in sigmas[3:]),
        )
    )
    rows.append(("rotation, camera axes [°]", "", ", ".join(f"{np.degrees(s):.2g}" for s in sigmas[:3])))
    shown = captioned(image(_on_table(table, picture, square_m), caption), caption)
    return "\n".join(["<h2>Table</h2>", shown, as_table(("", "value", "standard errors"), rows)])


def _on_table(table: TablePose, picture: NDArray[np.uint8], square_m: float) -> str:
    board: PosedBoard = table.board
    height, width = picture.shape
    with drawing((WIDE, WIDE * height / width)) as figure:
        ax = figure.subplots()
        ax.imshow(picture, cmap="gray", vmin=0, vmax=255)
        ax.plot(*board.view.pixels.T, "o", mfc="none", mec=BLUE, markersize=5)
        ax.plot(*(board.view.pixels - board.residuals_px).T, "+", color=ORANGE, markersize=5)
        ends = table.camera.project(np.concatenate([np.zeros((1, 3)), AXIS_SQUARES * square_m * np.eye(3)]))
        for end, colour in zip(ends[1:], AXIS_COLOURS, strict=True):
            ax.plot(*np.stack([ends[0], end]).T, color=hex_colour(colour), lw=2)
        ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        ax.set_axis_off()
        return as_address(figure, "png")


def _notes(calibration: Calibration) -> str:
    if not calibration.notices:
        return ""
    return "<h2>Notes</h2>\n<ul>" + "".join(f"<li>{escape(notice)}</li>" for notice in calibration.notices) + "</ul>"
