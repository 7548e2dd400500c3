"""Records are read back as they were written, bit by bit; other files are refused with file, row and column."""

from __future__ import annotations

import csv
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from diethrow.files.csv_and_json import read_json, write_json
from diethrow.files.fit_records import read_fit, write_fit
from diethrow.files.throw_records import (
    BOUNCE_COLUMNS,
    SIGMA_COLUMNS,
    SIMULATED_COLUMNS,
    TRACK_COLUMNS,
    covariance_path,
    read_bounces,
    read_simulated,
    read_track,
    read_vertices,
    simulated_track,
    write_bounces,
    write_simulated,
    write_track,
    write_vertices,
)
from diethrow.fitting.results import Effect, Fit, Parameter
from diethrow.model.die.solid import SHAPES, isohedral_solid
from diethrow.model.rotations import euler_from_quat, matrix_from_quat, quat_from_rotvec
from diethrow.model.throw.motion import Flight, Impact, State, Throw
from diethrow.tracking.track import ABSENT, LOST, TRACKED, Track


def some_track(seed: int = 1, n: int = 12) -> Track:
    """Random poses with full covariances; two frames lost, three absent."""
    rng = np.random.default_rng(seed)
    status = np.array([ABSENT] * 2 + [TRACKED] * (n - 5) + [LOST] * 2 + [ABSENT])
    known = status == TRACKED
    roots = rng.normal(size=(n, 6, 6)) * 1e-4
    covariance = roots @ roots.transpose(0, 2, 1)
    position, quaternion = rng.normal(size=(n, 3)), quat_from_rotvec(rng.normal(size=(n, 3)))
    for values in (position, quaternion, covariance):
        values[~known] = np.nan
    return Track(np.arange(40, 40 + n), np.arange(40, 40 + n) / 1500.0, position, quaternion, covariance, status)


def some_state(seed: int = 2) -> State:
    rng = np.random.default_rng(seed)
    return State(0.01, *(rng.normal(size=3), quat_from_rotvec(rng.normal(size=3))), *rng.normal(size=(2, 3)))


def some_impacts() -> tuple[Impact, ...]:
    """An impact with all numbers, one with few, and one of an edge."""
    known = Impact(
        0.1 / 3, "vertex", (3,), np.array([0.1 / 7, -0.2]), np.zeros(3), -0.7, 0.31, 1 / 3e3, 2 / 9e3, 1, 6, 1e-5
    )
    nan = float("nan")
    unknown = Impact(0.2, "unresolved", (), np.full(2, nan), np.zeros(3), nan, nan, nan, nan, 6, 2)
    edge = Impact(0.3, "edge", (1, 5), np.zeros(2), np.zeros(3), -0.1, 0.05, 1e-4, 9e-5, 2, 2, 1e-4, 0.5, 0.4, 0.6)
    return known, unknown, edge


def some_fit() -> Fit:
    return Fit(
        parameters={
            "chi": Parameter(0.5, 0.4, 0.6, 0.95, True, False),
            "mu": Parameter(None, None, None, None, False, False),
        },
        initial=some_state(),
        initial_covariance=np.eye(12) / 7,
        chosen=("impact",),
        considered=(Effect("friction", 1.5, "The data do not ask for it."), Effect("drag", None, "It was not tried.")),
        bounces_fitted=3,
        residual_rms=float("nan"),
        landed_face=None,
        face_odds={1: 0.25, 6: 0.75},
        messages=("Grüße, χ < 1.",),
        throw=None,
    )


def same(a: object, b: object) -> bool:
    """Whether arrays are equal bit by bit; NaN equals NaN."""
    if isinstance(a, np.ndarray):
        return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
    return a == b or (a != a and b != b)


def test_a_track_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    track = some_track()
    write_track(tmp_path / "track.csv", track)
    back = read_track(tmp_path / "track.csv")
    for part in fields(Track):
        assert same(getattr(track, part.name), getattr(back, part.name)), part.name


def test_a_track_has_the_agreed_columns_and_no_numbers_unless_tracked(tmp_path: Path) -> None:
    track = some_track()
    write_track(tmp_path / "track.csv", track)
    with (tmp_path / "track.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    agreed = (
        "frame,t_s,x_m,y_m,z_m,qw,qx,qy,qz,sigma_x_m,sigma_y_m,sigma_z_m,sigma_rx_rad,sigma_ry_rad,sigma_rz_rad,status"
    )
    assert tuple(rows[0]) == tuple(agreed.split(",")) == TRACK_COLUMNS
    for k, row in enumerate(rows):
        numbers = [row[name] for name in TRACK_COLUMNS[2:-1]]
        assert all(numbers) if track.tracked[k] else not any(numbers)
    covariance = np.load(covariance_path(tmp_path / "track.csv"), allow_pickle=False)
    assert covariance_path(tmp_path / "track.csv") == tmp_path / "track_covariance.npy"
    assert covariance.dtype == np.float64
    assert covariance.shape == (len(track), 6, 6)
    assert np.isnan(covariance[~track.tracked]).all()
    sigmas = [float(rows[2][name]) for name in SIGMA_COLUMNS]
    assert sigmas == np.sqrt(np.diag(covariance[2])).tolist()


def test_a_track_without_covariances_is_a_track(tmp_path: Path) -> None:
    path = tmp_path / "toss.csv"
    path.write_text("frame,t_s,x_m,y_m,z_m,qw,qx,qy,qz,status\n0,0.0,1,2,3,1,0,0,0,tracked\n1,0.1,,,,,,,,absent\n")
    track = read_track(path)
    assert track.position_m[0].tolist() == [1, 2, 3]
    assert np.isnan(track.covariance).all()
    assert np.isnan(track.position_m[1]).all()


def test_sigmas_alone_make_diagonal_covariances(tmp_path: Path) -> None:
    track = some_track()
    write_track(tmp_path / "track.csv", track)
    covariance_path(tmp_path / "track.csv").unlink()
    covariance = read_track(tmp_path / "track.csv").covariance
    for k in np.flatnonzero(track.tracked):
        # A root and a square: two roundings.
        np.testing.assert_allclose(covariance[k], np.diag(np.diag(track.covariance[k])), rtol=1e-15)


WRONG_TRACKS = {
    "no number": ("0,0.0,one,2,3,1,0,0,0,tracked", "x_m = 'one' in row 1"),
    "not finite": ("0,0.0,1,2,inf,1,0,0,0,tracked", "z_m = 'inf' in row 1"),
    "empty though tracked": ("0,0.0,,2,3,1,0,0,0,tracked", "x_m = '' in row 1"),
    "unknown status": ("0,0.0,1,2,3,1,0,0,0,seen", "status = 'seen' in row 1"),
    "half a frame": ("0.5,0.0,1,2,3,1,0,0,0,tracked", "frame = '0.5' in row 1"),
    "long quaternion": ("0,0.0,1,2,3,1,1,0,0,tracked", "qw to qz in row 1 have length 1.41421"),
    "time that stands": ("0,0.0,,,,,,,,lost\n1,0.0,,,,,,,,lost", "t_s = 0.0 in row 2"),
    "no rows": ("", "no rows"),
    "a short row": ("0,0.0,1,2,3", "status = ''"),
}


@pytest.mark.parametrize("mistake", WRONG_TRACKS)
def test_a_wrong_track_is_refused_with_row_and_column(tmp_path: Path, mistake: str) -> None:
    rows, fact = WRONG_TRACKS[mistake]
    path = tmp_path / "track.csv"
    path.write_text(f"frame,t_s,x_m,y_m,z_m,qw,qx,qy,qz,status\n{rows}\n")
    with pytest.raises(ValueError, match=r"track\.csv: ") as caught:
        read_track(path)
    assert fact in str(caught.value)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_track(path)
    path.write_text("time,x\n0,1\n")
    with pytest.raises(ValueError, match="column frame is missing"):
        read_track(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a CSV table"):
        read_track(path)
    path.write_text("a" * 500_000)
    with pytest.raises(ValueError, match="not a CSV table"):
        read_track(path)


def test_a_cell_longer_than_any_number_is_refused_and_csv_keeps_its_own_limit(tmp_path: Path) -> None:
    path, limit = tmp_path / "vertices.csv", csv.field_size_limit()
    for length in (1000, 1001):
        path.write_text(f"vertex,x_m,y_m,z_m\n0,1,2,3\n1,{'0' * length},2,3\n")
        if length == 1000:
            assert read_vertices(path)[1].tolist() == [0, 2, 3]
            continue
        with pytest.raises(ValueError, match=r"vertices\.csv: x_m has 1001 characters in row 2"):
            read_vertices(path)
    assert csv.field_size_limit() == limit


def test_covariances_of_another_track_or_another_kind_are_refused(tmp_path: Path) -> None:
    write_track(tmp_path / "track.csv", some_track())
    beside = covariance_path(tmp_path / "track.csv")
    np.save(beside, np.zeros((3, 6, 6)))
    with pytest.raises(ValueError, match=r"track_covariance\.npy: .*\(3, 6, 6\)"):
        read_track(tmp_path / "track.csv")
    np.save(beside, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="not an array of numbers"):
        read_track(tmp_path / "track.csv")


def test_bounces_are_read_back_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "bounces.csv"
    write_bounces(path, some_impacts())
    back = read_bounces(path)
    assert path.read_text().splitlines()[0] == ",".join(BOUNCE_COLUMNS)
    assert len(back) == 3
    for before, after in zip(some_impacts(), back, strict=True):
        for part in fields(Impact):
            if part.name != "impulse_N_s":
                assert same(getattr(before, part.name), getattr(after, part.name)), part.name


def test_an_unknown_number_of_a_bounce_is_an_empty_cell(tmp_path: Path) -> None:
    write_bounces(tmp_path / "bounces.csv", some_impacts())
    row = (tmp_path / "bounces.csv").read_text().splitlines()[2]
    assert row == "2,0.2,,unresolved,,,,,,,,,,,6,2"


@pytest.mark.parametrize("shape", SHAPES)
def test_vertices_are_read_back_as_they_were_written(tmp_path: Path, shape: str) -> None:
    solid = isohedral_solid(shape, 0.016)
    write_vertices(tmp_path / "vertices.csv", solid)
    assert same(read_vertices(tmp_path / "vertices.csv"), solid.vertices)


def test_a_fit_is_read_back_as_it_was_written_without_nan(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    fit = some_fit()
    write_fit(path, fit)
    back = read_fit(path)
    assert back.parameters == fit.parameters
    assert (back.chosen, back.considered, back.messages) == (fit.chosen, fit.considered, fit.messages)
    assert (back.bounces_fitted, back.landed_face, back.face_odds) == (3, None, {1: 0.25, 6: 0.75})
    assert back.residual_rms is None
    assert back.initial is not None
    assert fit.initial is not None
    for part in fields(State):
        assert same(getattr(fit.initial, part.name), getattr(back.initial, part.name)), part.name
    assert back.initial_covariance is not None
    assert fit.initial_covariance is not None
    assert same(fit.initial_covariance, back.initial_covariance)
    json.loads(path.read_text(encoding="utf-8"), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


def test_a_fit_holds_its_release_state_in_the_papers_angles_too(tmp_path: Path) -> None:
    write_fit(tmp_path / "fit.json", some_fit())
    initial = read_json(tmp_path / "fit.json")["initial"]
    state = some_state()
    assert initial["euler_rad"] == euler_from_quat(state.quaternion).tolist()
    # World and body components are of one vector.
    np.testing.assert_allclose(
        matrix_from_quat(state.quaternion) @ initial["omega_body_rad_s"], state.omega_rad_s, atol=1e-15
    )


def test_a_file_that_is_no_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    for text, fact in (("{", "not valid JSON"), ("[]", "not a fit"), ('{"parameters": {}}', "not a fit")):
        path.write_text(text)
        with pytest.raises(ValueError, match=fact):
            read_fit(path)
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_fit(tmp_path / "other.json")


def test_no_number_of_a_json_is_infinite_or_nan(tmp_path: Path) -> None:
    data = {"a": np.array([1.0, np.inf]), "b": [np.float64("nan"), np.int64(3)], "c": {4: (np.bool_(True), None)}}
    write_json(tmp_path / "a.json", data)
    assert read_json(tmp_path / "a.json") == {"a": [1.0, None], "b": [None, 3], "c": {"4": [True, None]}}


def test_the_models_track_covers_exactly_its_throw(tmp_path: Path) -> None:
    start = some_state()
    throw = Throw((Flight(start, start.time_s + 0.05),), ())
    frame = np.arange(60)
    track = simulated_track(throw, frame, frame / 500.0)
    covered = (frame / 500.0 >= 0.01 - 1e-9) & (frame / 500.0 <= 0.06 + 1e-9)
    assert (track.tracked == covered).all()
    np.testing.assert_array_equal(track.position_m[covered], throw.poses(frame[covered] / 500.0)[0])
    steps = np.sum(track.quaternion[covered][1:] * track.quaternion[covered][:-1], axis=1)
    assert (steps > 0).all()
    write_simulated(tmp_path / "simulated.csv", track)
    assert (tmp_path / "simulated.csv").read_text().splitlines()[0] == ",".join(SIMULATED_COLUMNS)
    back = read_simulated(tmp_path / "simulated.csv")
    for name in ("frame", "time_s", "position_m", "quaternion", "status"):
        assert same(getattr(track, name), getattr(back, name)), name
