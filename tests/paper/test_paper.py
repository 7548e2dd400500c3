"""The replication of the paper: every statement has a verdict, and the page agrees with the computed numbers."""

import json
from math import sqrt
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from diethrow.cli.app import app
from diethrow.files.outputs import OutputExistsError
from diethrow.model.ensembles.odds import Share
from diethrow.paper import replication as paper_module
from diethrow.paper.bounces_to_rest import last_face_changes, last_other
from diethrow.paper.corner_sequences import STATED, best_labelling, by_chance, placements, released
from diethrow.paper.release_face_odds import agrees, crossings, judge
from diethrow.paper.replication import PARTS, PaperPlan, paper, plan_of, summary
from diethrow.paper.results import FULL, Effort, Result, Run, Verdict, cell, tetrahedron
from diethrow.paper.solids import CUTS, FAIR, fair_cut

TINY = Effort(1000, 200, 24, 8, 64, 32, 2, 30, 100, 2, 80)


@pytest.fixture(scope="module")
def replicated(tmp_path_factory):
    """A whole run with hardly any throws: verdicts that depend on counts are arbitrary."""
    out = tmp_path_factory.mktemp("paper") / "out"
    replication = paper(PaperPlan(TINY), out, threads=2, command=("diethrow", "paper"))
    return out, replication


@pytest.fixture(scope="module")
def table(replicated):
    return json.loads((replicated[0] / "paper.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(replicated):
    return (replicated[0] / "paper.html").read_text(encoding="utf-8")


def test_every_statement_has_a_verdict_and_a_reason(table):
    keys = [result["key"] for result in table["results"]]
    assert len(set(keys)) == len(keys) == 13
    for result in table["results"]:
        assert result["verdict"] in {verdict.value for verdict in Verdict}
        assert result["why"]
        assert result["paper"]
        assert result["ours"]
    assert sum(table["verdicts"].values()) == 13


def test_verdicts_that_do_not_depend_on_the_throws_are_fixed(table):
    found = {result["key"]: result["verdict"] for result in table["results"]}
    assert found["inertias"] == Verdict.REPRODUCED.value
    assert found["fig_7"] == found["exponents_moving_table"] == Verdict.NOT_DECIDABLE.value
    # With v0z upwards the first six of eleven corners agree, which no number of throws changes.
    assert found["fig_5_cube"] == Verdict.NOT_REPRODUCED.value
    (cube,) = (result for result in table["results"] if result["key"] == "fig_5_cube")
    upwards = next(each for each in cube["numbers"]["variants"] if each["v0z_m_s"] > 0)
    assert upwards["agree_from_first"] == 6
    assert upwards["letters"].startswith("CDDCBA")


def test_the_page_shows_every_verdict_number_and_figure(table, page, replicated):
    for result in table["results"]:
        for text in (result["title"], result["ours"], result["why"], result["paper"]):
            assert _escaped(text) in page
        assert f'id="{result["key"]}"' in page
        for each in result["tables"]:
            for row in each["rows"]:
                shown = "<tr>" + "".join(f"<td>{_escaped(cell(value))}</td>" for value in row) + "</tr>"
                assert shown in page
    pictures = [picture["file"] for result in table["results"] for picture in result["pictures"]]
    assert page.count("data:image/png;base64,") == len(pictures) == len(set(pictures)) == 9


def test_no_figure_is_blank(table, replicated):
    for result in table["results"]:
        for picture in result["pictures"]:
            pixels = cv2.imread(str(replicated[0] / picture["file"]), cv2.IMREAD_GRAYSCALE)
            assert pixels is not None
            # Axes and letters alone would darken a few hundred pixels.
            assert (pixels < 200).sum() > 2000, picture["file"]


def test_the_page_needs_no_network_and_fits_a_phone(page):
    assert "http://" not in page
    assert "https://" not in page
    assert "<script" not in page
    assert 'name="viewport"' in page
    assert "@media print" in page


def test_a_line_for_every_statement_and_the_time(replicated):
    lines = summary(replicated[1])
    assert len(lines) == 14
    assert lines[-1].split(" ")[1] == "s"


def test_the_paper_s_number_of_throws_is_run():
    assert plan_of(quick=False, seed=1).effort == FULL
    assert FULL.throws == 2_000_000


def test_an_existing_folder_is_refused_before_any_throw(tmp_path):
    with pytest.raises(OutputExistsError, match="exists"):
        paper(PaperPlan(TINY), tmp_path)


def test_a_stopped_run_leaves_no_folder(tmp_path, monkeypatch):
    def stopped(run: Run) -> tuple[Result, ...]:
        (run.folder / "half.png").write_bytes(b"x")
        raise KeyboardInterrupt

    monkeypatch.setattr(paper_module, "PARTS", {"inertias": PARTS["inertias"], "stopped": stopped})
    with pytest.raises(KeyboardInterrupt):
        paper(PaperPlan(TINY), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_negative_seed_is_a_usage_error(tmp_path):
    ran = CliRunner().invoke(app, ["paper", "--seed", "-1", "--out", str(tmp_path / "out")])
    assert ran.exit_code == 2
    assert "seed -1" in ran.output


# The letters of Fig. 5


@pytest.mark.parametrize("stated", STATED.values(), ids=list(STATED))
def test_a_relabelled_sequence_agrees_in_full(stated):
    names = dict(zip("ABCD", (6, 0, 3, 5), strict=True))
    found = best_labelling(stated, [names[letter] for letter in stated])
    assert (found.matches, found.prefix, found.letters) == (len(stated), len(stated), stated)


def test_one_wrong_corner_costs_one_match_and_ends_the_prefix():
    vertices = [0, 1, 0, 2, 3, 0, 1, 0, 1, 3]  # A, B, A, C, D, A, B, A, B, D
    vertices[4] = 2
    found = best_labelling("ABACDABABD", vertices)
    assert (found.matches, found.prefix) == (9, 4)


def test_two_corners_never_share_a_letter_nor_two_letters_a_corner():
    assert best_labelling("AAAA", [1, 2, 1, 2]).matches == 2
    assert best_labelling("ABAB", [1, 1, 1, 1]).matches == 2


def test_sequences_are_compared_up_to_the_shorter_length():
    found = best_labelling("ABCD", [7, 3])
    assert (found.matches, found.prefix, found.letters) == (2, 2, "AB")


def test_of_equal_labellings_the_one_that_agrees_with_the_first_impacts_is_given():
    # Either A = 1 (first two) or A = 2 (last two) makes two agree.
    assert best_labelling("AAAA", [1, 1, 2, 2]).letters == "AA··"


def test_chance_alone_gives_some_agreements():
    chance = by_chance(STATED["cube"], 8, 2, seed=3)
    assert 4.0 < chance[:, 1].mean() < 7.0
    assert (chance[:, 1] >= chance[:, 0]).all()


def test_the_placements_of_the_tetrahedron_match_their_names():
    die = tetrahedron()
    for name, turn in placements(die.solid).items():
        corners = die.solid.vertices @ _matrix(turn).T
        if name.startswith("apex"):
            at_apex = corners[:, 2].argmax() if "up" in name else corners[:, 2].argmin()
            assert np.hypot(*corners[at_apex, :2]) < 1e-12
            direction = {"ξ": 0, "η": 1}[name[-1]]
            away = corners[:, direction] * (1.0 if "+" in name else -1.0)
            # One corner of the base points that way, at the base's circumradius a/√3.
            assert away.max() == pytest.approx(0.040793 / sqrt(3.0), rel=1e-12)


def test_another_gravity_gives_the_same_path_at_another_rate():
    slow = released(np.array([1.0, 0, 0, 0]), -0.7, gravity_m_s2=4 * 9.81)
    usual = released(np.array([1.0, 0, 0, 0]), -0.7)
    np.testing.assert_allclose(2.0 * slow.velocity_m_s, usual.velocity_m_s, rtol=1e-15)
    np.testing.assert_allclose(2.0 * slow.omega_rad_s, usual.omega_rad_s, rtol=1e-15)


# Verdicts


def test_odds_agree_within_rounding_and_three_errors():
    assert agrees(0.199, Share(398_900, 2_000_000))
    assert not agrees(0.199, Share(333_333, 2_000_000))


@pytest.mark.parametrize(
    ("stated", "verdict"),
    [(0.1667, Verdict.REPRODUCED), (0.199, Verdict.NOT_DECIDABLE), (0.121, Verdict.NOT_REPRODUCED)],
)
def test_a_number_is_judged_by_the_interpretations_that_agree(stated, verdict):
    n = 2_000_000
    readings = {
        20.0: {"at rest, of all throws": Share(n // 6, n), "lowest at impact 4": Share(int(0.204 * n), n)},
        40.0: {"at rest, of all throws": Share(n // 6, n), "lowest at impact 4": Share(int(0.185 * n), n)},
    }
    assert judge(stated, readings)[0] is verdict


def test_too_few_throws_decide_nothing():
    assert judge(0.199, {20.0: {"at rest, of all throws": Share(20, 100)}})[0] is Verdict.NOT_DECIDABLE


def test_a_level_is_crossed_between_its_neighbours():
    assert crossings([(0.0, 1.0), (2.0, 0.5), (4.0, 0.0), (6.0, 1.0)], 0.25) == [3.0, 4.5]


def test_the_fair_cut_lies_on_the_line_between_its_neighbours():
    n = 1_000_000
    shares = [Share(int(share * n), n) for share in (0.0, 0.0, 0.1, 0.3, 0.9, 1.0)]
    found = fair_cut(0.5, shares)
    assert found is not None
    assert found.cut == pytest.approx(0.5 * (CUTS[2] + CUTS[3]), abs=1e-12)
    assert fair_cut(0.5, [Share(0, n)] * 6) is None
    assert pytest.approx(0.2) == FAIR


def test_the_last_impact_on_another_face_is_the_one_before_the_face_stays():
    lowest = np.array([[3, 1, 2, 2, 2], [1, 1, 1, 1, 1], [2, 2, 2, 2, 2]])
    np.testing.assert_array_equal(last_other(lowest, np.array([2, 1, 0])), [1, 0])


def test_threads_change_no_count(tmp_path: Path):
    runs = [Run(tmp_path, TINY, 1, threads) for threads in (1, 3)]
    np.testing.assert_array_equal(*(last_face_changes(run, "cube", 0.3) for run in runs))


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("'", "&#x27;")


def _matrix(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
