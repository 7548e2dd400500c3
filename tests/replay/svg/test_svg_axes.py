"""Plots as SVG put every value where it belongs, keep gaps and extremes, and escape every text."""

from __future__ import annotations

import base64
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diethrow.replay.svg.axes import SvgAxes
from diethrow.replay.svg.paths import MAX_DOTS, UNITS_PER_PX, curve, dots, steps_after
from diethrow.replay.svg.ticks import round_ticks, tick_texts

HOSTILE = '"><script>alert(1)</script>&'
INCHES = 6.0, 3.0
BLUE = "#2b8cdc"


def parsed(ax: SvgAxes) -> ET.Element:
    return ET.fromstring(ax.svg("a plot"))


def data_box(ax: SvgAxes) -> ET.Element:
    """The inner picture, with the marks of the data."""
    (inner,) = parsed(ax).findall("svg")
    return inner


def points_of(path: str) -> list[np.ndarray]:
    """The points (n, 2) of each uninterrupted part of a path of M, m, l and h0."""
    parts: list[list[list[int]]] = []
    place = np.zeros(2, int)
    for command, text in re.findall(r"([Mmlh])([^Mmlh]*)", path):
        numbers = np.array([int(word) for word in re.findall(r"-?\d+", text)])
        if command == "M":
            place = numbers
            parts.append([place.tolist()])
        elif command == "m":
            place = place + numbers
            parts.append([place.tolist()])
        elif command == "l":
            for move in numbers.reshape(-1, 2):
                place = place + move
                parts[-1].append(place.tolist())
    return [np.array(part) for part in parts]


@given(
    low=st.floats(-1e5, 1e5),
    width=st.floats(1e-3, 1e6),
    most=st.integers(4, 11),
)
def test_ticks_are_round_within_the_limits_and_close_enough(low: float, width: float, most: int) -> None:
    ticks = round_ticks(low, low + width, most)
    assert 2 <= len(ticks) <= most
    step = ticks[1] - ticks[0]
    slack = 1e-5 * step
    assert low - slack <= ticks[0] < low + step + slack
    assert low + width - step - slack < ticks[-1] <= low + width + slack
    np.testing.assert_allclose(np.diff(ticks), step, rtol=1e-6)
    mantissa = step / 10.0 ** np.floor(np.log10(step * (1.0 + 1e-9)))
    assert min(abs(mantissa / round_one - 1.0) for round_one in (1.0, 2.0, 2.5, 5.0, 10.0)) < 1e-6
    assert len(set(tick_texts(ticks))) == len(ticks)


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [
        (-2.1, 2.1, ["−2", "−1", "0", "1", "2"]),
        (0.0, 0.35, ["0.0", "0.1", "0.2", "0.3"]),
        (0.0, 1.1, ["0.00", "0.25", "0.50", "0.75", "1.00"]),
        (-1e-7, 2.2e-6, ["0", "5 × 10⁻⁷", "1 × 10⁻⁶", "1.5 × 10⁻⁶", "2 × 10⁻⁶"]),
        (0.0, 4.5e7, ["0", "1 × 10⁷", "2 × 10⁷", "3 × 10⁷", "4 × 10⁷"]),
    ],
)
def test_ticks_have_the_decimals_that_tell_them_apart(low: float, high: float, wanted: list[str]) -> None:
    assert tick_texts(round_ticks(low, high, 5)) == wanted


def test_a_point_lies_at_the_affine_place_of_its_values() -> None:
    ax = SvgAxes(INCHES)
    ax.plot([10.0, 20.0, 25.0], [-1.0, 3.0, 0.0], color=BLUE)
    ax.set_xlim(0.0, 50.0)
    ax.set_ylim(-2.0, 6.0)
    inner = data_box(ax)
    width, height = float(inner.attrib["width"]), float(inner.attrib["height"])
    (found,) = points_of(inner[0].attrib["d"])
    wanted = UNITS_PER_PX * np.array([[0.2, 0.875], [0.4, 0.375], [0.5, 0.75]]) * [width, height]
    # Half a unit by rounding, and the width is written with one decimal.
    np.testing.assert_allclose(found, wanted, atol=1.1)


@pytest.mark.parametrize("limits", [(0.0, 50.0), (50.0, 0.0)])
def test_limits_and_ticks_are_as_matplotlib_understands_them(limits: tuple[float, float]) -> None:
    """Ticks lie, in shares of the axis, where matplotlib puts them, also on an axis that points the other way."""
    ax, other = SvgAxes(INCHES), Figure(figsize=INCHES).subplots()
    for each in (ax, other):
        each.set_xlim(*limits)
        each.set_xticks([5.0, 20.0], ["five", "twenty"])
    root = parsed(ax)
    inner = root.find("svg")
    assert inner is not None
    left, width = float(inner.attrib["x"]), float(inner.attrib["width"])
    for value, name in ((5.0, "five"), (20.0, "twenty")):
        (text,) = (text for text in root.iter("text") if text.text == name)
        wanted = other.transAxes.inverted().transform(other.transData.transform((value, 0.0)))[0]
        assert (float(text.attrib["x"]) - left) / width == pytest.approx(wanted, abs=1e-3)


def drawn_on(kind: Callable[[], SvgAxes | Axes]) -> tuple[float, float, float, float]:
    ax = kind()
    ax.plot([1.0, np.nan, 3.0, 9.0], [2.0, 100.0, 7.0, np.nan], "-", color=BLUE)
    ax.axhline(-3.0, color=BLUE, linewidth=1.0, zorder=1.0)
    ax.axvline(5.0, color=BLUE, linewidth=1.0, linestyle=(0, (2, 2)), zorder=1.0)
    ax.axhspan(0.0, 9.0, color=BLUE, alpha=0.5, linewidth=0.0, zorder=0.0)
    ax.set_xlim(left=0.0)
    if isinstance(ax, SvgAxes):
        return (*ax._x.limits(), *ax._y.limits())
    return (*ax.get_xlim(), *ax.get_ylim())


def test_the_limits_contain_the_data_as_those_of_matplotlib_do() -> None:
    """x is compared where it is set only: matplotlib lets it reach to points whose y is unknown."""
    ours, theirs = drawn_on(lambda: SvgAxes(INCHES)), drawn_on(lambda: Figure().subplots())
    np.testing.assert_allclose([ours[0], *ours[2:]], [theirs[0], *theirs[2:]], rtol=1e-12)
    assert ours[1] == pytest.approx(5.0 + 0.05 * 4.0)


def test_what_is_unknown_interrupts_a_line() -> None:
    x = np.arange(6.0) * 100.0
    y = np.array([0.0, 10.0, np.nan, 30.0, np.inf, 50.0])
    parts = points_of(curve(x, y))
    assert [part.tolist() for part in parts] == [[[0, 0], [100, 10]], [[300, 30]], [[500, 50]]]
    assert curve(x, np.full(6, np.nan)) == dots(x, np.full(6, np.nan)) == ""


def test_a_thinned_curve_keeps_the_extremes_of_every_column_and_stays_short() -> None:
    rng = np.random.default_rng(5)
    x = np.linspace(0.0, 8000.0, 200_000)
    y = np.rint(rng.normal(0.0, 300.0, x.size))
    path = curve(x, y)
    (found,) = points_of(path)
    column, of_found = np.rint(x).astype(int) // UNITS_PER_PX, found[:, 0] // UNITS_PER_PX
    for k in np.unique(column)[::97]:
        here, there = y[column == k], found[of_found == k, 1]
        assert (there.min(), there.max()) == (here.min(), here.max())
    assert found[0].tolist() == [0, y[0]]
    assert found[-1].tolist() == [8000, y[-1]]
    assert len(path) < 40_000


@pytest.mark.parametrize("count", [50, 60_000])
def test_dots_keep_the_extremes_of_every_column_and_are_few(count: int) -> None:
    rng = np.random.default_rng(6)
    points = np.rint(np.stack([rng.uniform(0.0, 8000.0, count), rng.normal(0.0, 300.0, count)], axis=1))
    found = np.concatenate(points_of(dots(*points.T)))
    assert {tuple(point) for point in found.tolist()} <= {tuple(point) for point in points.tolist()}
    assert len(found) <= MAX_DOTS + 2 * 801
    column, of_found = points[:, 0] // UNITS_PER_PX, found[:, 0] // UNITS_PER_PX
    assert set(column) == set(of_found)
    for k in np.unique(column)[::37]:
        here, there = points[column == k, 1], found[of_found == k, 1]
        assert (there.min(), there.max()) == (here.min(), here.max())


def test_few_dots_are_all_drawn_once() -> None:
    found = np.concatenate(points_of(dots(np.array([5.0, 1.0, 5.0, 3.0]), np.array([2.0, -7.0, 2.0, 4.0]))))
    assert sorted(map(tuple, found.tolist())) == [(1, -7), (3, 4), (5, 2)]


def test_a_step_changes_at_the_next_point() -> None:
    x, y = steps_after(np.array([0.0, 1.0, 3.0]), np.array([5.0, 6.0, 7.0]))
    assert list(zip(x, y, strict=True)) == [(0, 5), (1, 5), (1, 6), (3, 6), (3, 7)]


def test_every_text_is_escaped() -> None:
    ax = SvgAxes(INCHES)
    ax.plot([0.0, 1.0], [0.0, 1.0], "-o", color=HOSTILE, label=HOSTILE)
    ax.bar([HOSTILE], [1.0], color=HOSTILE)
    ax.text(0.0, 0.0, HOSTILE, color=HOSTILE, bbox={"fc": HOSTILE})
    ax.axhspan(0.0, 1.0, color=HOSTILE, alpha=1.0)
    ax.set_xlabel(HOSTILE)
    ax.set_ylabel(HOSTILE)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))
    root = ET.fromstring(ax.svg(HOSTILE))
    assert root.attrib["aria-label"] == HOSTILE
    assert [text.text for text in root.iter("text")].count(HOSTILE) == 5
    assert not list(root.iter("script"))


def test_a_picture_has_its_grey_levels_and_its_place() -> None:
    levels = np.repeat(np.arange(0, 240, 30, dtype=np.uint8), 8)[None].repeat(32, axis=0)
    ax = SvgAxes(INCHES)
    ax.imshow(levels)
    inner = data_box(ax)
    image = inner[0]
    assert image.tag == "image"
    assert [int(image.attrib[name]) for name in ("x", "y")] == [0, 0]
    width, height = (int(image.attrib[name]) for name in ("width", "height"))
    assert inner.attrib["viewBox"] == f"0 0 {width} {height}"
    assert width / height == pytest.approx(2.0, rel=1e-3)
    data = np.frombuffer(base64.b64decode(image.attrib["href"].partition(",")[2]), np.uint8)
    found = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert found is not None
    # Blocks of eight pixels are those of JPEG; what is left is its rounding.
    np.testing.assert_allclose(found.astype(float), levels, atol=2.0)


def test_a_picture_finer_than_screens_is_shrunk() -> None:
    ax = SvgAxes((1.0, 1.0))
    ax.imshow(np.full((3000, 4000), 77, np.uint8))
    data = np.frombuffer(base64.b64decode(data_box(ax)[0].attrib["href"].partition(",")[2]), np.uint8)
    found = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert found is not None
    assert found.shape[1] <= 192
    assert np.abs(found.astype(int) - 77).max() <= 1


def test_pictures_of_other_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="8 bits"):
        SvgAxes(INCHES).imshow(np.zeros((4, 4), np.uint8), cmap="viridis")


def test_a_legend_outside_gets_its_space_and_a_hidden_line_is_not_drawn() -> None:
    boxes = []
    for anchor in ((0.0, 1.0), (1.0, 0.5)):
        ax = SvgAxes(INCHES)
        ax.plot([0.0, 1.0], [0.0, 1.0], color=BLUE, label="a long name")
        ax.legend(loc="lower left" if anchor[0] == 0.0 else "center left", bbox_to_anchor=anchor)
        ax.spines[:].set_visible(False)
        ax.tick_params(length=0.0)
        root = parsed(ax)
        inner = root.find("svg")
        assert inner is not None
        boxes.append([float(inner.attrib[name]) for name in ("y", "width")])
        (name,) = (text for text in root.iter("text") if text.text == "a long name")
        x, y = float(name.attrib["x"]), float(name.attrib["y"])
        right = float(inner.attrib["x"]) + float(inner.attrib["width"])
        assert y < float(inner.attrib["y"]) if anchor[0] == 0.0 else x > right
        assert not [path for path in root.findall("path") if path.attrib.get("d") == ""]
    assert boxes[0][0] > boxes[1][0]
    assert boxes[0][1] > boxes[1][1] + 50.0


def test_the_report_and_an_analysis_load_no_matplotlib() -> None:
    code = (
        "import sys, pathlib, tempfile\n"
        "import diethrow.commands.clip.analyze\n"
        "import replay_records as made\n"
        "from diethrow.replay.pages import write_report\n"
        "with tempfile.TemporaryDirectory() as folder:\n"
        "    write_report(pathlib.Path(folder) / 'report.html', made.record())\n"
        "print(sorted(name for name in sys.modules if name.partition('.')[0] == 'matplotlib'))\n"
    )
    helpers = next(path for path in sys.path if path.endswith("helpers"))
    run = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {helpers!r})\n{code}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stdout.strip()) == (0, "[]"), run.stderr
