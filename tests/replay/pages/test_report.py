"""The report states every result or the reason why there is none; it needs no network and escapes every text."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import replay_records as made

from diethrow.fitting.predict.sequential import Estimate
from diethrow.fitting.results import Effect, Parameter
from diethrow.model.throw.motion import Throw
from diethrow.replay.elements import findings_text
from diethrow.replay.elements.record import ReportDetails
from diethrow.replay.pages.report import report_page, write_report
from diethrow.tracking.check.verdicts import Finding, Verdict
from diethrow.tracking.track import TRACKED, Track

HOSTILE = "<script>alert(1)</script> \" onload='x' & <img src=http://example.org/x>"


class Page(HTMLParser):
    """Checks that every element closes, and keeps tags, attributes and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in ("meta", "img", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def whole() -> str:
    return report_page(made.record())


def test_the_page_is_well_formed_and_has_every_section(whole: str) -> None:
    parsed = Page(whole)
    assert parsed.open == []
    for heading in ("The throw", "Bounces", "Fit", "Initial conditions", "Effects", "Messages of the fit"):
        assert heading in parsed.text
    assert "0.5831" in parsed.text
    assert "0.5802 to 0.5859" in parsed.text
    assert "The last frame is cut off." in parsed.text


def test_the_page_requests_nothing_from_the_network(whole: str) -> None:
    parsed = Page(whole)
    assert not {"link", "iframe", "object"} & set(parsed.tags)
    # The data of the player, and the script that plays them.
    assert parsed.tags.count("script") == 2
    addresses = [value for name, value in parsed.attributes if name in ("src", "href", "action", "data")]
    assert addresses
    assert all(value is not None and value.startswith("data:") for value in addresses)
    names = "http://www.w3.org/2000/svg"  # a namespace, which no browser loads
    assert not re.search(r"https?:|@import|url\(", whole.replace(names, ""))


def test_every_text_is_escaped() -> None:
    fit = made.fit(messages=(HOSTILE,), parameters={HOSTILE: Parameter(1.0, 0.9, 1.1, 0.95, True, False)})
    hostile = report_page(made.record(title=HOSTILE, notices=(HOSTILE,), fit=fit))
    parsed = Page(hostile)
    assert parsed.open == []
    assert parsed.tags.count("script") == 2
    assert not [name for name, _ in parsed.attributes if name.startswith("on")]
    assert parsed.text.count("<script>alert(1)</script>") >= 4


def test_a_value_that_is_not_determined_is_given_with_its_reason() -> None:
    reason = "χ is not determined: no bounce lies in the clip."
    fit = made.fit(
        parameters={"chi": Parameter(None, None, None, None, False, False)},
        bounces_fitted=0,
        residual_rms=None,
        initial_covariance=None,
        messages=(reason,),
    )
    flights = made.throw().flights[:1]
    text = Page(report_page(made.record(fit=fit, measured=Throw(flights, ()), simulated=None))).text
    assert "χ not determined" in text
    assert f"not determined: {reason}" in text
    assert "No bounce was observed." in text
    assert "None" not in text
    assert "nan" not in text


def test_findings_and_provenance_are_shown_and_escaped() -> None:
    origin = {
        "diethrow": "0.1.0",
        "command": ["diethrow", "analyze", HOSTILE],
        "python": "3.11",
        "platform": HOSTILE,
        "packages": {"numpy": "2"},
        "inputs": [{"path": HOSTILE, "bytes": 12, "sha256": "ab" * 32}],
        "timings_s": {"track": 1.53125},
    }
    findings = (Finding("scale", Verdict.DOUBTFUL, HOSTILE, HOSTILE),)
    parsed = Page(report_page(made.record(), ReportDetails(findings=findings, origin=origin)))
    assert parsed.open == []
    assert parsed.tags.count("script") == 2
    assert parsed.text.count("<script>alert(1)</script>") == 5
    for text in ("doubtful", "ab" * 32, "numpy 2"):
        assert text in parsed.text
    # Two runs take different times and give the same page.
    assert "1.53" not in parsed.text


def test_the_verdict_has_observation_model_and_landing() -> None:
    sentences = findings_text.verdict(made.record())
    assert len(sentences) == 3
    assert all(sentence.endswith(".") for sentence in sentences)
    assert "χ is 0.5831 (95 % interval 0.5802 to 0.5859)" in sentences[1]
    assert "only bounce" in sentences[1]


def test_the_effects_that_were_included_tried_and_not_tried_are_named() -> None:
    considered = (Effect("air drag", 0.8, "It gains too little."), Effect("clock", 2.1, "So does this."))
    text = " ".join(
        findings_text.effects_sentences(made.fit(chosen=("friction", "rounded corners"), considered=considered))
    )
    # The radius is not a parameter of this fit: the scene states it, so the frames did not require it.
    assert "without friction." in text
    assert "includes friction and rounded corners" in text
    assert re.search("Two other effects were tried and rejected.* 2.1, from clock", text)
    assert (
        "simplest model of this scene is sufficient: smooth impact"
        in findings_text.effects_sentences(made.fit(chosen=("smooth impact",)))[0]
    )


def test_a_face_is_certain_from_the_bounce_after_which_its_odds_stay_high() -> None:
    chi = made.fit().parameters["chi"]

    def sentences(*odds: float) -> str:
        known = tuple(Estimate(k, 0.01 * k, chi, {1: p, 2: 1.0 - p}) for k, p in enumerate(odds, 1))
        return " ".join(findings_text.certainty_sentences(known))

    assert re.search("Face 1 is certain .* after bounce 2 .* 20.0 ms", sentences(0.5, 0.97, 1.0))
    assert "after bounce 3" in sentences(0.99, 0.1, 1.0)
    assert "No face becomes certain" in sentences(0.99, 0.6)
    assert sentences(1.0) == ""


def test_a_record_without_fit_clip_or_camera_still_gives_a_page() -> None:
    text = Page(report_page(made.record(fit=None, clip=None, camera=None, simulated=None, notices=()))).text
    assert "No model was fitted" in text


def test_a_bounce_without_known_velocities_is_a_row_without_numbers() -> None:
    throw = made.throw()
    vague = replace(
        throw.impacts[0],
        contact="unresolved",
        vertices=(),
        normal_velocity_before_m_s=np.nan,
        normal_velocity_after_m_s=np.nan,
        energy_before_J=np.nan,
        energy_after_J=np.nan,
        chi=np.nan,
        chi_low=np.nan,
        chi_high=np.nan,
        sigma_time_s=np.nan,
        point_m=np.full(2, np.nan),
    )
    text = Page(report_page(made.record(measured=Throw(throw.flights, (vague,))))).text
    assert "could not be resolved" in text
    assert "nan" not in text


def test_the_same_record_gives_the_same_page(tmp_path: Path, whole: str) -> None:
    write_report(tmp_path / "report.html", made.record())
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == whole


def test_the_page_of_a_long_clip_stays_small() -> None:
    """20 000 frames, each with a residual, in under 2 MB: points that would cover each other are left out."""
    count, rng = 20_000, np.random.default_rng(3)
    throw = made.throw()
    times = np.linspace(throw.flights[0].start.time_s, throw.flights[-1].end_s, count)
    positions, quaternions = throw.poses(times)
    frames, status = np.arange(count), np.full(count, TRACKED)
    covariance = np.broadcast_to(np.diag([1e-5**2] * 3 + [1e-3**2] * 3), (count, 6, 6))
    noisy = positions + rng.normal(0.0, 1e-5, positions.shape)
    tilted = made.turned(quaternions, rng.normal(0.0, 1e-3, 3))
    track = Track(frames, times, noisy, tilted, covariance, status)
    model = Track(frames, times, positions, quaternions, covariance, status)
    page = report_page(made.record(track=track, simulated=model, clip=None, camera=None))
    assert 2e5 < len(page.encode()) < 2e6


@pytest.mark.parametrize(
    ("width", "decimals"),
    [(0.0057, 4), (0.031, 3), (0.4, 2), (3.0, 2), (0.0, 4), (1e-12, 8)],
)
def test_an_interval_is_written_with_two_digits_of_its_width(width: float, decimals: int) -> None:
    assert findings_text.decimals_for(width) == decimals


def test_numbers_have_a_true_minus_sign_and_no_bare_nan() -> None:
    assert findings_text.number(-0.5) == "−0.5"
    assert findings_text.number(1.5e-7) == "1.5 × 10⁻⁷"
    assert (
        findings_text.number(np.nan) == findings_text.fixed(np.nan, 3) == findings_text.number(None) == "not determined"
    )
