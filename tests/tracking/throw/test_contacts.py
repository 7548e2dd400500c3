"""Laws of contacts: what any impact obeys sharpens it, what is none is not called one, and a die at rest does not fly."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import studio
from numpy.typing import NDArray
from scipy.signal import lfilter
from throws import FPS, frame_covariance, initial_errors, random_release, seen, strike_at, true_throw

from diethrow.model.die.die import Die, make_die
from diethrow.model.die.symmetry import symmetry_rotations
from diethrow.model.laws import CoulombImpact, ImpactLaw, SmoothImpact
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    rotation_between,
)
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.throw import measurement
from diethrow.tracking.throw.contacts import UNKNOWN_TABLE_M, Priors, ResolvedChain, explains_better, resolve_contacts
from diethrow.tracking.throw.flight_chain import (
    LEVER_SHARE,
    MIN_LEVER_SIGMA_RAD_S,
    TABLE_SIGMA_M,
    FlightChain,
    Link,
    VertexImpact,
    fit_chain,
    vertex_impact_cost,
    vertex_impact_equations,
)
from diethrow.tracking.throw.flights import (
    ErrorModel,
    Observations,
    packed,
    perturbed,
    propagate_chain,
    transition_matrix,
    unpacked,
)
from diethrow.tracking.throw.measurement import determines_table_height, measure, measure_throw
from diethrow.tracking.throw.rest import (
    FRAMES_LEFT_TO_FLIGHT,
    SupportedMotion,
    first_supported_row,
    flights_only,
    frames_in_flight,
    on_table,
)
from diethrow.tracking.throw.segmentation import segment_flights
from diethrow.tracking.throw.smoothing import smooth
from diethrow.tracking.track import LOST, TRACKED, Track

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.016, 0.0048)
ROUND = make_die("cube", 0.016, 0.0048, corner_radius_m=0.001)
TETRA = make_die("tetrahedron", 0.022, 0.0015)
OCTA = make_die("octahedron", 0.016, 0.003)


def observations_of(track: Track) -> Observations:
    return Observations.from_poses(track.time_s, track.position_m, track.quaternion, track.covariance, unmodelled=0.0)


def bounced(die: Die, law: ImpactLaw, seed: int, frames_after: int) -> tuple[Throw, Track]:
    """One bounce, and so many frames of the flight behind it."""
    rng = np.random.default_rng(seed)
    release = random_release(die, rng)
    whole = throw_die(die, release, law, until=Until(impacts=1)).throw
    end_s = whole.impacts[0].time_s + frames_after / FPS
    throw = Throw((whole.flights[0], replace(whole.flights[1], end_s=end_s)), whole.impacts)
    return throw, seen(throw, rng)


def joined_at(throw: Throw, track: Track, strike: VertexImpact | None) -> FlightChain:
    return fit_chain(
        observations_of(track), [f.start for f in throw.flights], [Link(throw.impacts[0].time_s, impact=strike)]
    )


LAWS = {"smooth": SmoothImpact(0.6), "friction": CoulombImpact(0.6, 0.2)}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("die", [CUBE, ROUND], ids=["sharp", "round"])
def test_every_impact_obeys_the_rules_of_a_strike_at_its_own_vertex_and_at_no_other(die: Die, law: ImpactLaw) -> None:
    throw, track = bounced(die, law, 3, 40)
    vertex = throw.impacts[0].vertices[0]
    free = joined_at(throw, track, None).cost
    costs = [joined_at(throw, track, strike_at(die, v)).cost - free for v in range(8)]
    # Four rules: chi-square of 4 is below 18 in 999 of a thousand cases; a wrong corner is millimetres off the table.
    assert costs[vertex] < 18.0
    assert min(np.delete(costs, vertex)) > 100.0


@pytest.mark.parametrize("die", [CUBE, ROUND], ids=["sharp", "round"])
def test_what_a_strike_costs_is_known_before_it_is_fitted(die: Die) -> None:
    throw, track = bounced(die, LAWS["friction"], 3, 40)
    starts, t = [f.start for f in throw.flights], throw.impacts[0].time_s
    white = ErrorModel.white()
    free = fit_chain(observations_of(track), starts, [Link(t)], errors=white)
    vertex = throw.impacts[0].vertices[0]
    for v in range(8):
        struck = fit_chain(observations_of(track), starts, [Link(t, impact=strike_at(die, v))], errors=white)
        told, found = vertex_impact_cost(free, 0, strike_at(die, v), TABLE_SIGMA_M), struck.cost - free.cost
        if v == vertex:
            # To the first order, but for Tukey's loss, which a frame at one sigma feels by a twentieth.
            assert told == pytest.approx(found, rel=0.2, abs=0.5)
        else:
            assert min(told, found) > 100.0


@pytest.mark.parametrize("die", [CUBE, ROUND], ids=["sharp", "round"])
def test_what_a_strike_obeys_changes_as_its_rows_say(die: Die) -> None:
    """By the states on both sides and by the instant, which carries both on; central differences."""
    throw, _ = bounced(die, LAWS["friction"], 3, 40)
    t, (before, behind) = throw.impacts[0].time_s, throw.flights
    strike = strike_at(die, throw.impacts[0].vertices[0])
    # A little beside what the impact obeys, so that no term is zero.
    a, b = perturbed(before.at(t), np.full(12, 1e-4)), perturbed(behind.at(t), np.full(12, -2e-4))
    rows, miss = vertex_impact_equations(a, b, strike, 0.0)
    steps = np.concatenate([np.tile(np.repeat([1e-7, 1e-6, 1e-5, 1e-3], 3), 2), [1e-8]])

    def missed(change: Array) -> Array:
        sides = [Flight(perturbed(s, c), np.inf).at(t + change[24]) for s, c in ((a, change[:12]), (b, change[12:24]))]
        # The tolerance of the spin is set by the jump as it stands.
        new, scale = vertex_impact_equations(sides[0], sides[1], strike, 0.0)[1], np.ones(4)
        scale[1:] = lever(sides) / lever([a, b])
        return np.asarray(new * scale)

    def lever(sides: list[State]) -> float:
        return LEVER_SHARE * float(np.linalg.norm(sides[1].omega_rad_s - sides[0].omega_rad_s)) + MIN_LEVER_SIGMA_RAD_S

    for k, step in enumerate(steps):
        change = np.zeros(25)
        change[k] = step
        slope = (missed(change) - missed(-change)) / (2.0 * step)
        np.testing.assert_allclose(rows[:, k], slope, rtol=1e-3, atol=1e-4 * np.abs(rows[:, k]).max() + 1e-6)
    assert np.abs(miss).max() > 0.1


def test_a_strike_makes_nothing_less_sure_and_keeps_its_sigma_true() -> None:
    misses = []
    for seed in range(12):
        throw, track = bounced(CUBE, LAWS["friction"], 20 + seed, 3)
        free, struck = (joined_at(throw, track, s) for s in (None, strike_at(CUBE, throw.impacts[0].vertices[0])))
        # The scale of the scatter is found anew, and moves by a per cent or two.
        assert struck.sigma_time_s[0] < 1.05 * free.sigma_time_s[0]
        before, after = (np.sqrt(np.diag(joined.flights[1].covariance)) for joined in (free, struck))
        assert (after < 1.05 * before).all()
        misses.append((struck.links[0].time_s - throw.impacts[0].time_s) / struck.sigma_time_s[0])
    assert 0.3 < np.mean(np.square(misses)) < 2.2  # twelve squared normals: 1 ± 0.41


def test_a_state_is_carried_on_as_its_flight_says() -> None:
    rng = np.random.default_rng(2)
    state = State(
        0.2, rng.normal(size=3), quat_from_rotvec([0.3, -1.0, 0.4]), rng.normal(size=3), 90 * rng.normal(size=3)
    )
    none, closed = np.zeros((1, 6)), np.zeros(1, bool)
    for after in (-0.01, 0.0, 1e-7, 0.03):
        _, ends, passages = propagate_chain(packed(state), np.array([0.2 + after]), none, closed, np.zeros((1, 14)))
        there, flight = unpacked(ends[0]), Flight(state, np.inf)
        wanted = flight.at(0.2 + after)
        for name in ("position_m", "quaternion", "velocity_m_s", "omega_rad_s"):
            np.testing.assert_allclose(getattr(there, name), getattr(wanted, name), atol=1e-12)
        np.testing.assert_allclose(passages[0], transition_matrix(flight, 0.2 + after), atol=1e-12)


@cache
def fast_tetrahedron() -> tuple[Throw, Track]:
    """Five impacts within ten frames, three of them within one and a half."""
    start = State(
        0.0378, np.array([0.00218, 0.01104, 0.06377]), np.array([-0.78617494, 0.0, 0.0, 0.0]),
        np.array([-0.087, -0.106, -1.251]), np.array([15.897, -6.324, 30.383]),
    )  # fmt: skip
    for seed in range(400):
        rng = np.random.default_rng(seed)
        release = replace(random_release(TETRA, rng), omega_rad_s=start.omega_rad_s)
        whole = throw_die(TETRA, release, SmoothImpact(0.55), until=Until(impacts=6)).throw
        frames = np.array([impact.time_s for impact in whole.impacts]) * FPS
        gaps = np.diff(frames)
        crowded = gaps[:4].sum() < 11.0 and gaps[:4].min() > 0.4 and (gaps[:4] < 3.0).sum() >= 2
        if crowded and gaps[4] > 40.0:
            end = whole.flights[5].start.time_s + 40.0 / FPS
            throw = Throw((*whole.flights[:5], replace(whole.flights[5], end_s=end)), whole.impacts[:5])
            return throw, seen(throw, rng)
    raise AssertionError("no seed throws a tetrahedron so")


def quick_track(relabel: int) -> tuple[Throw, Track]:
    """Its track, taken up behind the contacts under another labelling."""
    throw, track = fast_tetrahedron()
    turn = quat_from_matrix(symmetry_rotations(TETRA.solid)[relabel])
    late = track.time_s > throw.impacts[-1].time_s + 2.0 / FPS
    quaternion = np.where(late[:, None], quat_multiply(track.quaternion, turn), track.quaternion)
    hidden = (track.time_s > throw.impacts[1].time_s) & ~late
    return throw, replace(track, quaternion=quaternion, status=np.where(hidden, LOST, TRACKED))


@pytest.mark.parametrize("relabel", [0, 5])
def test_impacts_within_a_few_frames_are_told_apart_or_left_unresolved(relabel: int) -> None:
    throw, track = quick_track(relabel)
    found = measure_throw(track, TETRA)
    for impact in found.impacts:
        if impact.contact == "unresolved":
            continue
        gaps = np.array([abs(impact.time_s - true.time_s) for true in throw.impacts])
        nearest = throw.impacts[int(gaps.argmin())]
        assert gaps.min() < max(4.0 * impact.sigma_time_s, 0.05 / FPS)
        assert impact.vertices == nearest.vertices


def test_a_few_quick_impacts_with_frames_between_are_resolved_whole() -> None:
    throw, track = fast_tetrahedron()
    found = measure_throw(track, TETRA)
    assert [i.vertices for i in found.impacts] == [i.vertices for i in throw.impacts]
    for a, b in zip(found.impacts, throw.impacts, strict=True):
        assert abs(a.time_s - b.time_s) * FPS < 0.3


def to_rest(die: Die, law: ImpactLaw, seed: int) -> tuple[Throw, Track]:
    """A throw until 60 ms after its last impact."""
    rng = np.random.default_rng(seed)
    release = random_release(die, rng)
    ended = throw_die(die, release, law).throw
    end_s = ended.flights[-1].start.time_s + 0.06
    throw = throw_die(die, release, law, until=Until(time_s=end_s)).throw
    return throw, seen(throw, rng)


@pytest.mark.parametrize("law", [SmoothImpact(0.2), CoulombImpact(0.2, 0.3)], ids=["smooth", "friction"])
@pytest.mark.parametrize("seed", range(2))
def test_a_die_that_rolls_or_lies_is_not_fitted_with_flights(law: ImpactLaw, seed: int) -> None:
    throw, track = to_rest(CUBE, law, seed)
    found = measure_throw(track, CUBE)
    last = found.impacts[-1]
    assert last.contact == "held"
    assert isinstance(found.flights[-1], SupportedMotion)
    # From where it is carried on, the lowest corner of the true die never leaves the table by more than a small hop.
    behind = track.time_s[track.time_s >= last.time_s]
    heights = [
        (throw.at(float(t)).rotation @ CUBE.solid.vertices.T)[2].min() + throw.at(float(t)).position_m[2]
        for t in behind
    ]
    assert max(heights) < 1e-3
    # No bounce is told of behind it, and those before it each have a true one within two frames.
    told = [impact.time_s for impact in found.impacts[:-1]]
    true = np.array([impact.time_s for impact in throw.bounces])
    assert all(np.abs(true - t).min() * FPS < 2.0 for t in told)
    assert all(t < last.time_s for t in told)


def test_frames_at_rest_keep_their_own_poses_and_are_left_out_of_fits() -> None:
    _, track = to_rest(CUBE, SmoothImpact(0.2), 0)
    found = measure_throw(track, CUBE)
    smoothed = smooth(track, found)
    still = track.time_s >= found.impacts[-1].time_s
    np.testing.assert_array_equal(smoothed.position_m[still], track.position_m[still])
    np.testing.assert_array_equal(smoothed.covariance[still], track.covariance[still])
    assert (smoothed.status == TRACKED).all()
    assert all(impact.contact != "held" for impact in flights_only(found).impacts)
    assert (frames_in_flight(track, flights_only(found)).status[still] == LOST).all()
    p, q = found.poses(track.time_s[still])
    np.testing.assert_allclose(p, track.position_m[still], atol=1e-12)
    np.testing.assert_allclose(rotation_between(q, track.quaternion[still]), 0.0, atol=1e-9)


def unsure_along(track: Track, sight: Array, sigma_m: float) -> Track:
    """The track with a further error of every pose along a line of sight, which its covariances know."""
    far_m = sigma_m * np.random.default_rng(5).standard_normal(len(track))
    covariance = track.covariance.copy()
    covariance[:, :3, :3] += sigma_m**2 * np.outer(sight, sight)
    return replace(track, position_m=track.position_m + far_m[:, None] * sight, covariance=covariance)


@pytest.mark.parametrize("table_m", [0.0, 2e-3])
def test_the_table_tells_how_far_away_a_die_is_that_it_carries(table_m: float) -> None:
    throw, track = to_rest(ROUND, SmoothImpact(0.2), 0)
    up = np.array([0.0, 0.0, table_m])
    rows = np.flatnonzero(track.time_s >= throw.flights[-1].start.time_s)
    sight = np.array([0.0, 0.9, -0.4]) / np.hypot(0.9, 0.4)
    unsure = unsure_along(replace(track, position_m=track.position_m + up), sight, 6e-4)
    told = on_table(unsure, rows, ROUND, table_m, TABLE_SIGMA_M)
    p, q = throw.poses(track.time_s[rows])
    off = np.concatenate([told.position_m[rows] - p - up, rotation_between(q, told.quaternion[rows])], axis=1)
    squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(told.covariance[rows]), off)
    # A height known to 0.09 mm is a distance known to 0.2: the line of sight goes down by 24 degrees. Hops are lower than they
    # may be; the median of chi-square with six is 5.35.
    assert np.std((unsure.position_m[rows] - p) @ sight) > 5e-4
    assert np.sqrt(np.mean((off[:, :3] @ sight) ** 2)) < 2e-4
    assert np.median(squares) < 7.5
    # What is in flight is left as it is.
    np.testing.assert_array_equal(told.position_m[: rows[0]], unsure.position_m[: rows[0]])
    np.testing.assert_array_equal(told.covariance[: rows[0]], unsure.covariance[: rows[0]])


@pytest.mark.parametrize("every", [1, 3])
def test_a_measured_throw_has_all_frames_on_the_table_that_carries_them(every: int) -> None:
    throw, track = to_rest(CUBE, SmoothImpact(0.2), 3)
    camera = studio().camera
    sight = throw.flights[-1].start.position_m - camera.centre_m
    unsure = unsure_along(track, sight / np.linalg.norm(sight), 4e-4)
    found = measure(unsure, CUBE, camera, every=every)
    still = track.time_s >= found.throw.impacts[-1].time_s + 1.5 * every / FPS
    p, _ = throw.poses(track.time_s[still])
    assert np.std(found.frames.position_m[still] - p) > 1.5 * np.std(found.frames_on_table.position_m[still] - p)
    lowest = (matrix_from_quat(found.frames_on_table.quaternion[still]) @ CUBE.solid.vertices.T)[:, 2].min(1)
    assert np.abs(lowest + found.frames_on_table.position_m[still, 2]).max() < 3e-4
    # For a fit their errors are as slow as those of the others, and nothing in common comes on top of what the table told.
    slow = found.chain.errors.long_run_variance(every / FPS).max()
    fitted, told = (one.covariance[still, 1, 1] for one in (found.independent_frames, found.frames_on_table))
    assert np.median(fitted / told) < 1.2 * slow


def test_a_die_that_nearly_rests_flies_from_bounce_to_bounce() -> None:
    # Hops of a tenth of a millimetre last for some frames, and poses that rest on marks tell them.
    told, wanted = 0, 0
    for seed in range(4):
        throw, _ = to_rest(CUBE, SmoothImpact(0.3), seed)
        track = seen(throw, np.random.default_rng(seed), noise=0.2)
        true = np.array([impact.time_s for impact in throw.bounces])
        found = np.array([impact.time_s for impact in flights_only(measure_throw(track, CUBE)).impacts])
        assert all(np.abs(true - t).min() * FPS < 1.5 for t in found)
        alone = true[[np.sort(np.abs(true - t))[1] * FPS > 8.0 for t in true]]
        told, wanted = told + sum(np.abs(found - t).min() * FPS < 0.5 for t in alone), wanted + len(alone)
    # The others come after the die has first been carried over an edge.
    assert told >= 0.7 * wanted


def test_a_die_that_tips_over_an_edge_does_not_fly() -> None:
    # The centre of a cube on an edge turns about it with α = m g d/(J + m d²) at the distance d beside it, and falls with α d.
    edge, start = CUBE.solid.edge_m, np.radians(20.0)
    t = np.arange(80) / FPS
    joint_covariance, up = 0.5 * np.sqrt(2.0) * edge * np.array([np.sin(start), np.cos(start)])
    moment = CUBE.inertia_kg_m2 + CUBE.mass_kg * (joint_covariance**2 + up**2)
    turn = 0.5 * CUBE.mass_kg * 9.81 * joint_covariance / moment * t**2
    angle = start + turn
    position = 0.5 * np.sqrt(2.0) * edge * np.stack([np.sin(angle), 0.0 * t, np.cos(angle)], axis=1)
    quaternion = quat_from_rotvec((np.radians(45.0) + angle)[:, None] * np.array([0.0, 1.0, 0.0]))
    rng = np.random.default_rng(0)
    covariance = frame_covariance(rng, len(t), 0.2)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.standard_normal((len(t), 6)))
    poses = position + errors[:, :3], quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternion)
    assert (
        first_supported_row(Observations.from_poses(t, *poses, covariance, unmodelled=0.0), CUBE)
        == FRAMES_LEFT_TO_FLIGHT
    )


def test_frames_that_no_flight_goes_through_keep_their_own_poses() -> None:
    whole, _ = bounced(CUBE, LAWS["smooth"], 3, 40)
    t = whole.impacts[0].time_s
    aside = np.array([0.004, 0.0, 0.001, 0.3, 0.2, 0.0, 0.2, 0.0, 0.1, 5.0, 0.0, -9.0])
    behind = Flight(perturbed(whole.flights[1].at(t), aside), whole.flights[1].end_s)
    track = seen(Throw((whole.flights[0], behind), whole.impacts), np.random.default_rng(3))
    between = np.flatnonzero(track.time_s > t)[:5]
    position = track.position_m.copy()
    position[between] -= 0.002 * np.arange(6.0, 1.0, -1.0)[:, None] * np.array([1.0, 0.0, 0.0])
    track = replace(track, position_m=position)
    found = measure(track, CUBE)
    assert [impact.contact for impact in found.throw.impacts] == ["unresolved"]
    assert set(np.flatnonzero(found.unexplained)) <= set(between)
    assert found.unexplained[between].sum() > 2
    smoothed = smooth(track, found.throw_without_shared_errors, found.shared_covariance, found.unexplained)
    np.testing.assert_array_equal(smoothed.position_m[found.unexplained], position[found.unexplained])
    assert (np.abs(smoothed.position_m - position)[~found.unexplained] > 0.0).any(1).all()


def test_a_weak_bounce_of_a_fast_die_is_found_though_its_errors_hide_its_signs() -> None:
    # At 340 rad/s the corner changes its speed by 0.2 m/s within the uncertainty of the instant, more than the bounces of
    # 0.12 and 0.29 m/s do.
    die = make_die("cube", 0.016, 0.0048, corner_radius_m=0.0005)
    q = np.array([0.2824187342771245, -0.6880700646279545, 0.21730166282100863, -0.6321227982183639])
    spin, velocity = np.array([8.23, -17.395, -14.84]), np.array([0.011, -0.05, -3.0411])
    release = State(0.0, np.array([0.00341, -0.0155, 0.12862949999999995]), q, velocity, spin)
    whole = throw_die(die, release, SmoothImpact(0.45), until=Until(impacts=3)).throw
    last = whole.flights[-1]
    throw = Throw((*whole.flights[:-1], replace(last, end_s=last.start.time_s + 80 / FPS)), whole.impacts)
    for seed in range(4):
        found = measure_throw(seen(throw, np.random.default_rng(seed), noise=0.5), die)
        assert [impact.vertices for impact in found.impacts] == [impact.vertices for impact in throw.impacts]


@pytest.mark.parametrize("seed", range(10))
def test_a_die_in_flight_is_not_at_rest_even_where_it_passes_low(seed: int) -> None:
    rng = np.random.default_rng(seed)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.5, impacts=3, frames_after=40)
    track = seen(throw, rng)
    assert first_supported_row(
        Observations.from_poses(track.time_s, track.position_m, track.quaternion, track.covariance), CUBE
    ) == len(track)
    assert flights_only(throw) is throw
    assert frames_in_flight(track, replace_end(throw)) is track


@pytest.mark.parametrize("seed", range(4))
def test_a_die_in_flight_is_not_at_rest_though_a_very_fast_film_shows_it_erring_alike(seed: int) -> None:
    # 15 ms of a hop of a quarter of a millimetre, on 15 000 frames whose slow errors, a twentieth of their variance, stay
    # alike for 400.
    rng = np.random.default_rng(seed)
    time_s, keep = np.arange(15_000) / 1e6, np.exp(-1.0 / 400.0)
    orientation = quat_from_rotvec(rng.normal(size=3))
    up = -(State(0.0, np.zeros(3), orientation, np.zeros(3), np.zeros(3)).rotation @ CUBE.solid.vertices.T)[2].min()
    hop = State(0.0, np.array([0.0, 0.0, up]), orientation, np.array([0.1, 0.0, 0.07]), 2.0 * rng.normal(size=3))
    position, quaternion = Flight(hop, np.inf).poses(time_s)
    covariance = frame_covariance(rng, len(time_s))
    slow = lfilter([np.sqrt(0.05 * (1.0 - keep**2))], [1.0, -keep], rng.standard_normal((len(time_s), 6)), axis=0)
    whole = rng.standard_normal((len(time_s), 6)) + slow
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), whole)
    poses = position + errors[:, :3], quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternion)
    seen_so = Observations.from_poses(time_s, *poses, covariance, unmodelled=0.0)
    assert first_supported_row(seen_so, CUBE) == len(time_s)


def replace_end(throw: Throw) -> Throw:
    return Throw((*throw.flights[:-1], replace(throw.flights[-1], end_s=np.inf)), throw.impacts)


def test_poses_that_jump_high_above_the_table_are_no_contact() -> None:
    # A stretch of frames taken wrongly parts the track; the motion before it stays clear of the table.
    start = State(
        0.0,
        np.array([0.0, 0.0, 0.05]),
        quat_from_rotvec([0.3, 0.2, 0.1]),
        np.array([0.1, 0.0, 0.4]),
        np.array([30.0, 10.0, -5.0]),
    )
    throw = Throw((Flight(start, 120 / FPS),), ())
    rng = np.random.default_rng(1)
    track = seen(throw, rng)
    position, quaternion = track.position_m.copy(), track.quaternion.copy()
    position[100:109] += [0.0, 0.004, -0.003]
    quaternion[100:109] = quat_multiply(quat_from_rotvec([0.3, 0.2, 0.0]), quaternion[100:109])
    assert measure_throw(replace(track, position_m=position, quaternion=quaternion), CUBE).impacts == ()


def test_a_table_at_another_height_than_stated_does_not_bend_the_flights() -> None:
    rng = np.random.default_rng(11)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=1)
    track = seen(throw, rng)
    lifted = replace(track, position_m=track.position_m + np.array([0.0, 0.0, 0.004]))
    plain, found = measure(track, CUBE), measure(lifted, CUBE)
    assert found.chain.table_m == pytest.approx(0.004, abs=5e-4)
    assert determines_table_height(plain.chain)
    # Neither what rests on it nor what strikes it is put where the scene has the table.
    assert not determines_table_height(found.chain)
    assert found.throw.impacts[0].time_s == pytest.approx(plain.throw.impacts[0].time_s, abs=0.02 / FPS)


@pytest.mark.parametrize("second_is_open", [True, False], ids=["both open", "one open"])
def test_contacts_that_no_frame_parts_are_one(second_is_open: bool) -> None:
    # Something happened within five hidden frames that no impact does: the die comes out aside and turned.
    whole, _ = bounced(CUBE, LAWS["smooth"], 3, 40)
    t = whole.impacts[0].time_s
    aside = np.array([0.004, 0.0, 0.001, 0.3, 0.2, 0.0, 0.2, 0.0, 0.1, 5.0, 0.0, -9.0])
    behind = Flight(perturbed(whole.flights[1].at(t), aside), whole.flights[1].end_s)
    throw = Throw((whole.flights[0], behind), whole.impacts)
    track = seen(throw, np.random.default_rng(3))
    poses = observations_of(track).rows(np.flatnonzero(np.abs(track.time_s - t) > 2.0 / FPS))
    links = [Link(t - 1.0 / FPS, is_open=True), Link(t + 1.0 / FPS, is_open=second_is_open)]
    chain = fit_chain(poses, [throw.flights[0].start, behind.start, behind.start], links)
    settled = resolve_contacts(poses, chain, CUBE, Priors(np.zeros(0), TABLE_SIGMA_M)).chain
    assert [link.is_open for link in settled.links] == [True]
    # It is told of where the motion before comes down to the table, which its many frames know to a tenth of a frame.
    assert abs(settled.links[0].time_s - t) < 0.3 / FPS
    for fitted, true in zip(settled.flights, throw.flights, strict=True):
        errors = initial_errors(fitted.at(t), true.at(t))
        sigma = np.sqrt(np.diag(transition_matrix(fitted, t) @ fitted.covariance @ transition_matrix(fitted, t).T))
        # Twelve numbers, the largest of which is seldom beyond three sigmas.
        assert np.abs(errors / sigma).max() < 4.0


def chains_of(throw: Throw, track: Track) -> dict[str, FlightChain]:
    """The chain of the true impacts of a throw of two, and what else may be made of its frames."""
    strikes = [strike_at(CUBE, impact.vertices[0]) for impact in throw.impacts]
    links = [Link(impact.time_s, impact=strike) for impact, strike in zip(throw.impacts, strikes, strict=True)]
    starts = [flight.start for flight in throw.flights]
    middle_s = 0.5 * (throw.impacts[0].time_s + throw.impacts[1].time_s)
    some = {
        "true": (starts, links),
        "opened": (starts, [links[0], Link(links[1].time_s, is_open=True)]),
        "one left out": (starts[:2], links[:1]),
        "one too many": (
            [*starts[:2], throw.flights[1].at(middle_s), starts[2]],
            [links[0], Link(middle_s, is_open=True), links[1]],
        ),
    }
    return {name: fit_chain(observations_of(track), *guess) for name, guess in some.items()}


@pytest.mark.parametrize("seed", [2, 4, 7])
def test_the_true_impacts_explain_the_frames_best(seed: int) -> None:
    rng = np.random.default_rng(seed)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=2, frames_after=30)
    track = seen(throw, rng)
    poses, rules = observations_of(track), Priors(np.zeros(0), TABLE_SIGMA_M)
    chains = {name: ResolvedChain(poses, joined, rules) for name, joined in chains_of(throw, track).items()}
    for name, other in chains.items():
        assert not explains_better(poses, other, chains["true"])
        assert name == "true" or explains_better(poses, chains["true"], other)


def test_a_table_that_is_not_where_it_is_said_to_be_denies_no_impact() -> None:
    """Chains are compared by the rules that were found to hold."""
    rng = np.random.default_rng(4)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=2, frames_after=30)
    track = seen(throw, rng)
    lifted = replace(track, position_m=track.position_m + np.array([0.0, 0.0, 0.002]))
    poses, told, found = (
        observations_of(lifted),
        Priors(np.zeros(0), TABLE_SIGMA_M),
        Priors(np.zeros(0), UNKNOWN_TABLE_M),
    )
    starts = [flight.start for flight in throw.flights]
    struck = [Link(impact.time_s, impact=strike_at(CUBE, impact.vertices[0])) for impact in throw.impacts]
    opened = [Link(impact.time_s, is_open=True) for impact in throw.impacts]
    true = ResolvedChain(poses, found.fit(poses, starts, struck), found)
    assert true.chain.table_m == pytest.approx(0.002, abs=2e-4)
    assert explains_better(poses, true, ResolvedChain(poses, told.fit(poses, starts, opened), told))


def test_flights_that_a_first_parting_gets_wrong_are_parted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=2, frames_after=30)
    track = seen(throw, rng)
    plain, partings = measure_throw(track, CUBE), []

    def wrong_at_first(some: Observations, die: Die) -> list[NDArray[np.int64]]:
        partings.append(segment_flights(some, die))
        return partings[-1] if len(partings) > 1 else [np.arange(len(some))]

    monkeypatch.setattr(measurement, "segment_flights", wrong_at_first)
    found = measure_throw(track, CUBE)
    assert len(partings) == 2
    assert [impact.vertices for impact in found.impacts] == [impact.vertices for impact in plain.impacts]
    for one, other in zip(found.impacts, throw.impacts, strict=True):
        assert abs(one.time_s - other.time_s) < 0.1 / FPS


@pytest.mark.parametrize("seed", [901, 911, 926])
def test_no_two_contacts_share_an_instant_and_those_that_are_named_are_right(seed: int) -> None:
    # Three or four impacts within some frames: on these throws fits have drawn two of them to one instant, or have taken
    # the true story with one more impact in it for another story.
    rng = np.random.default_rng(seed)
    die, chi = [CUBE, TETRA, OCTA][(seed - 900) % 3], [0.4, 0.6, 0.8][(seed - 900) // 3 % 3]
    throw = true_throw(die, random_release(die, rng), chi, impacts=4, frames_after=50)
    found = measure_throw(seen(throw, rng), die)
    times_s = np.array([impact.time_s for impact in found.impacts])
    assert (np.diff(times_s) * FPS > 1e-3).all()
    for impact in found.impacts:
        true = min(throw.impacts, key=lambda true: abs(true.time_s - impact.time_s))
        assert impact.vertices in ((), true.vertices)


def test_what_no_frame_knows_of_stays_where_it_is() -> None:
    throw, track = bounced(CUBE, LAWS["smooth"], 3, 20)
    t = throw.impacts[0].time_s
    inside = track.time_s[np.searchsorted(track.time_s, t)]
    links = [Link(t), Link(0.5 * (t + inside))]
    third = perturbed(throw.flights[1].start, np.zeros(12))
    joined = fit_chain(observations_of(track), [throw.flights[0].start, throw.flights[1].start, third], links)
    assert np.isfinite(joined.joint_covariance).all()
    assert all(np.isfinite(flight.covariance).all() for flight in joined.flights if flight.covariance is not None)
    assert np.median(joined.residual) < 2.0


def test_a_few_poses_gone_wild_hide_no_bounce() -> None:
    tried = 0
    for seed in range(60, 80):
        rng = np.random.default_rng(seed)
        throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=1, frames_after=40)
        if throw.flights[1].end_s - throw.flights[1].start.time_s < 20 / FPS:
            continue
        track = seen(throw, rng)
        wild = rng.choice(len(track), 4, replace=False)
        position, quaternion = track.position_m.copy(), track.quaternion.copy()
        position[wild] += 0.02 * rng.normal(size=(4, 3))
        quaternion[wild] = quat_multiply(quat_from_rotvec(rng.normal(size=(4, 3))), quaternion[wild])
        found = measure_throw(replace(track, position_m=position, quaternion=quaternion), CUBE)
        assert [impact.vertices for impact in found.impacts] == [throw.impacts[0].vertices]
        assert abs(found.impacts[0].time_s - throw.impacts[0].time_s) * FPS < 0.2
        tried += 1
    assert tried > 4
