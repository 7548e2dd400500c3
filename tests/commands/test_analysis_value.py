"""`import diethrow as dt`: an analysis as a value, its folder, and the model alone."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from command_line import invoke
from rrd_files import contents

import diethrow as dt
from diethrow.model.ensembles import ThrowSetup, Window, final_configurations

mpl.use("Agg")

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data_samples" / "cube_mirror"
CUBE = dt.make_die("cube", 0.016, 0.0048)
SHOWN = r"<Analysis cube_mirror: chi 0\.4\d+, 3 bounces, 1\d\d of 170 frames tracked>"
TABLES = ("frames", "bounces", "parameters", "effects", "covariance", "simulated")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sample, which tests may move."""
    return Path(shutil.copytree(SAMPLE, tmp_path_factory.mktemp("clips") / "cube_mirror"))


@pytest.fixture(scope="module")
def analysis(place: Path) -> dt.Analysis:
    return dt.analyze(place / "scene.toml")


@pytest.fixture(scope="module")
def folder(analysis: dt.Analysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("saved") / "out"
    assert analysis.save(out).folder == out
    return out


def assert_same(one: dt.Analysis, other: dt.Analysis) -> None:
    for name in TABLES:
        pd.testing.assert_frame_equal(getattr(one, name), getattr(other, name), obj=name)
    assert one.result.messages == other.result.messages
    assert one.notices == other.notices
    assert one.model is not None
    assert other.model is not None
    times = np.linspace(one.model.flights[0].start.time_s, one.model.flights[-1].end_s, 40)
    for a, b in zip(one.model.poses(times), other.model.poses(times), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    assert [i.vertices for i in one.model.impacts] == [i.vertices for i in other.model.impacts]


def test_a_saved_analysis_is_loaded_as_the_same_value(analysis: dt.Analysis, folder: Path, tmp_path: Path) -> None:
    loaded = dt.load(folder)
    assert_same(analysis, loaded)
    pages = [one.report(tmp_path / f"{k}.html").read_bytes() for k, one in enumerate((analysis, loaded))]
    assert pages[0] == pages[1]


def test_a_folder_of_the_command_is_loaded_as_the_value_of_the_function(
    analysis: dt.Analysis, place: Path, tmp_path: Path
) -> None:
    status, _, notes = invoke("analyze", place / "scene.toml", "--out", tmp_path / "out")
    assert status == 0, notes
    loaded = dt.load(tmp_path / "out")
    # Rounding depends on where arrays lie in memory, and at the edge of the picture it shows in the fifth digit.
    assert loaded.parameters.loc["chi", "value"] == pytest.approx(analysis.parameters.loc["chi", "value"], rel=1e-3)
    assert len(loaded.frames) == len(analysis.frames)
    assert loaded.folder == tmp_path / "out"


def test_tables_say_their_units(analysis: dt.Analysis) -> None:
    assert analysis.frames.attrs["units"]["sigma_rx_rad"] == "rad"
    assert analysis.frames.attrs["frame"] == "world"
    assert analysis.bounces.attrs["units"]["normal_velocity_after_m_s"] == "m/s"
    assert analysis.parameters.loc["chi", "unit"] == "1"
    assert len(analysis.frames) == len(analysis.track)
    assert analysis.bounces.index.tolist() == [1, 2, 3]
    covariance = analysis.covariance
    assert covariance is not None
    assert list(covariance.columns) == list(covariance.index)
    assert covariance.loc["chi", "chi"] == pytest.approx(analysis.result.covariance[-1, -1])  # type: ignore[index]


@pytest.mark.parametrize(
    "name", ["heights", "bounces", "residuals", "rotation_residuals", "stroboscope", "correlation", "landing"]
)
def test_every_plot_draws_on_the_axes_it_is_given(analysis: dt.Analysis, name: str) -> None:
    from matplotlib import pyplot as plt

    figure, ax = plt.subplots()
    assert getattr(analysis.plot, name)(ax) is ax
    assert ax.has_data() or ax.images or ax.patches
    plt.close(figure)


def test_a_fit_without_effects_on_trial_has_the_plainest_law(analysis: dt.Analysis) -> None:
    plain = analysis.fit(effects=())
    assert plain.effects.index.tolist()[0] == "smooth impact"
    assert not plain.result.considered
    assert plain.folder is None
    with pytest.raises(ValueError, match="'magic' is none; wanted some of friction"):
        analysis.fit(effects=("magic",))


def test_a_prediction_has_errors_that_grow_from_its_release_on(analysis: dt.Analysis) -> None:
    predicted = analysis.predict()
    sigmas = predicted["sigma_z_m"].dropna()
    assert len(sigmas) > 20
    assert sigmas.iloc[-1] > 5.0 * sigmas.iloc[0]
    # The frame of the first bounce is the first that the state does not use.
    assert analysis.frames.loc[sigmas.index[0], "t_s"] == pytest.approx(analysis.bounces.loc[1, "t_s"], abs=1e-3)
    with pytest.raises(ValueError, match="lies behind the last frame"):
        analysis.predict(from_frame=100_000)


def test_what_a_notebook_shows_fits_a_screen(analysis: dt.Analysis) -> None:
    assert re.fullmatch(SHOWN, repr(analysis))
    shown = analysis._repr_html_()
    assert f"<td>chi</td><td>{analysis.result.parameters['chi'].value:.5g}</td>" in shown
    assert len(shown) < 4000


def test_a_report_and_a_recording_are_written_from_the_value(analysis: dt.Analysis, tmp_path: Path) -> None:
    page, recording = analysis.report(tmp_path / "page.html"), analysis.recording(tmp_path / "throw.rrd")
    assert "cube_mirror" in page.read_text()
    assert recording.stat().st_size > 100_000


def test_the_report_command_draws_the_page_of_a_folder_again(folder: Path, tmp_path: Path) -> None:
    wanted = (folder / "report.html").read_text()
    status, output, notes = invoke("report", folder, "--out", tmp_path / "again.html")
    assert status == 0, notes
    assert "again.html" in output
    assert (tmp_path / "again.html").read_text() == wanted


def test_without_scene_and_clip_a_folder_is_loaded_without_pictures_of_them(
    analysis: dt.Analysis, folder: Path, place: Path
) -> None:
    place.rename(place.with_name("elsewhere"))
    try:
        loaded = dt.load(folder)
    finally:
        place.with_name("elsewhere").rename(place)
    assert_same(analysis, loaded)
    assert loaded.record.clip is None
    with pytest.raises(ValueError, match="stroboscope: this analysis has no data for the figure; it has heights"):
        loaded.plot.stroboscope()


@pytest.mark.parametrize(
    ("change", "error", "expected"),
    [
        (
            lambda f: (f / "analysis.json").unlink(),
            FileNotFoundError,
            "has no analysis.json; wanted a folder that analyze",
        ),
        (lambda f: edit(f / "analysis.json", format=7), ValueError, "format 7; this version reads 1"),
        (
            lambda f: edit(f / "analysis.json", camera={"width_px": 3}),
            ValueError,
            "wanted the analysis.json that analyze",
        ),
        (
            lambda f: edit(f / "provenance.json", understood={"path": "s.toml"}),
            ValueError,
            "its scene cannot be read again",
        ),
        (lambda f: (f / "track_frames_throw.npz").unlink(), FileNotFoundError, "has no track_frames_throw.npz"),
    ],
)
def test_a_folder_that_holds_no_analysis_is_refused_in_a_sentence(
    folder: Path, tmp_path: Path, change, error: type[Exception], expected: str
) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    change(copy)
    with pytest.raises(error, match=expected):
        dt.load(copy)


def test_a_recording_is_drawn_again_from_its_folder(folder: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    before = contents(copy / "replay.rrd")
    (copy / "replay.rrd").unlink()
    assert invoke("replay", copy)[0] == 0
    assert contents(copy / "replay.rrd") == before
    (copy / "replay.rrd").write_bytes(b"damaged")
    assert invoke("replay", copy)[0] == 1
    assert invoke("replay", copy, "--redraw")[0] == 0
    assert contents(copy / "replay.rrd") == before


def test_the_report_of_another_fit_hands_on_its_own_tables(folder: Path, tmp_path: Path) -> None:
    again = dt.load(folder).fit(effects=(), intervals="covariance")
    page = again.report(tmp_path / "report.html").read_text()
    found = re.search('download="fit.json" href="data:application/json;base64,([^"]*)"', page)
    assert found is not None
    table = json.loads(base64.b64decode(found[1]))
    assert table["choices"]["intervals"] == "covariance"
    assert table["effects"]["considered"] == []


def edit(path: Path, **entries: object) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))


def test_a_plain_script_without_a_main_guard_runs_once(place: Path) -> None:
    script = f"import diethrow as dt\nprint('begun')\nprint(dt.analyze({str(place / 'scene.toml')!r}))\n"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    begun, shown = run.stdout.splitlines()
    assert begun == "begun"
    assert re.fullmatch(SHOWN, shown)


def test_the_poses_become_an_xarray_dataset(analysis: dt.Analysis) -> None:
    xarray = pytest.importorskip("xarray")
    found = dt.to_xarray(analysis)
    assert isinstance(found, xarray.Dataset)
    np.testing.assert_array_equal(found.position_m.values, analysis.track.position_m)


# --- the model alone ---


RELEASE = dt.State(
    0.0, np.array([0, 0, 0.1]), np.array([1, 0.2, 0.1, 0.3]), np.array([0, 0, -1.0]), np.array([20, 5, 3.0])
)


def test_a_throw_is_that_of_the_model() -> None:
    one = dt.throw(CUBE, dt.SmoothImpact(0.5), RELEASE)
    unit = dt.State(0.0, RELEASE.position_m, RELEASE.quaternion / np.linalg.norm(RELEASE.quaternion),
                    RELEASE.velocity_m_s, RELEASE.omega_rad_s)  # fmt: skip
    same = dt.throw_die(CUBE, unit, dt.SmoothImpact(0.5))
    assert one.landed_face == same.landed_face
    assert one.bounces["t_s"].tolist() == [impact.time_s for impact in same.throw.bounces]
    assert one.poses(1000.0)["z_m"].iloc[0] == pytest.approx(0.1)
    assert one.plot_heights().has_data()
    assert "<SimulatedThrow of a cube" in repr(one)


@pytest.mark.parametrize("lasts_s", [0.0, 1e-5, 4e-4, 0.1])
def test_a_throw_plays_however_short_it_is(lasts_s: float) -> None:
    release = replace(RELEASE, time_s=0.00037)
    one = dt.throw(CUBE, dt.SmoothImpact(0.5), release, until=dt.Until(time_s=0.00037 + lasts_s))
    assert ("<canvas" in one._repr_html_()) == (lasts_s > 0.0)


def test_throws_odds_and_basins_take_air_drag() -> None:
    law, unit = dt.SmoothImpact(0.5), RELEASE.quaternion / np.linalg.norm(RELEASE.quaternion)
    one = dt.throw(CUBE, law, RELEASE, drag_per_m=0.5)
    same = dt.throw_die(CUBE, replace(RELEASE, quaternion=unit), law, drag_per_m=0.5)
    assert one.bounces["t_s"].tolist() == [impact.time_s for impact in same.throw.bounces]
    assert dt.odds(CUBE, law, throws=100, drag_per_m=0.5).tally.rested == 100
    x, y = dt.Axis("theta", 0.2, 1.2, 4), dt.Axis("phi", 0.1, 2.0, 3)
    assert (dt.basins(CUBE, law, x, y, drag_per_m=0.5).face > 0).all()


def test_odds_do_not_depend_on_the_threads() -> None:
    one, two = (dt.odds(CUBE, dt.SmoothImpact(0.5), throws=3000, threads=n) for n in (1, 2))
    pd.testing.assert_frame_equal(one.faces, two.faces)
    assert one.faces["count"].sum() == one.tally.rested
    assert ((one.faces["low"] < 1 / 6) & (one.faces["high"] > 1 / 6)).sum() >= 4
    assert one.plot().has_data()
    with pytest.raises(ValueError, match="wanted a higher lowest release"):
        dt.odds(CUBE, dt.SmoothImpact(0.5), releases=dt.UniformConditions(0.0, (0.001, 0.002)))


def test_basins_are_the_landing_faces_of_their_points() -> None:
    law, x, y = dt.SmoothImpact(0.3), dt.Axis("theta", 0.2, 1.2, 7), dt.Axis("phi", 0.1, 2.0, 5)
    found = dt.basins(CUBE, law, x, y)
    window = Window(x, y)
    points = np.stack(np.meshgrid(x.centres, y.centres), -1).reshape(-1, 2)
    wanted = final_configurations(ThrowSetup(CUBE, law), window, points)
    np.testing.assert_array_equal(found.face.ravel(), np.maximum(wanted, 0))
    assert found.face.shape == (5, 7)
    assert found.plot().images
