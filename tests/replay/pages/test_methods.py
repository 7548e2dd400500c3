"""The methods of a report say what was done, cite it, and leave out what is not known; its tables can be saved."""

from __future__ import annotations

import base64
import re
from dataclasses import replace

import numpy as np
import pytest
import replay_records as made

from diethrow.fitting.results import Choices, Effect, Parameter
from diethrow.model.throw.motion import Throw
from diethrow.replay.elements.record import ReportDetails
from diethrow.replay.pages.downloads import MOST_BYTES, downloads_html
from diethrow.replay.pages.interval_sources import SOURCES, share_words, sources_html
from diethrow.replay.pages.methods import bibtex, methods_text
from diethrow.replay.pages.report import report_page

SHARES = {"chi": {"noise": 0.84, "calibration": 0.05, "die": 0.109, "clock": 0.001, "impact law": 0.0}}


def test_the_methods_state_the_measurement_and_the_fit() -> None:
    fit = made.fit(considered=(Effect("friction", 0.3, "Too little."),), variance_shares=SHARES)
    paragraphs, references = methods_text(made.record(fit=fit), ReportDetails(origin={"diethrow": "1.2.3"}))
    text = " ".join(paragraphs)
    for words in (
        "edge 16 mm, mass 4.8 g",
        "filmed at 1500 frames per second",
        "measured on 53 of the 57 frames",
        "0.01 mm or less along the world's axes and 0.057° or less",
        "One impact was found",
        "before and after 1 impact, with the rigid-impact model of Kapitaniak et al. [2]",
        "No effect beyond the smooth impact was needed. One other effect did not improve it by the criterion of [3].",
        "profile-likelihood interval [4], is χ = 0.5831 (95 % interval 0.5802 to 0.5859)",
        "1 standard errors",
        "84 % noise of the frames, 11 % edge of the die, 5 % calibration of the camera",
    ):
        assert words in text, words
    assert [reference.key for reference in references] == ["diethrow", "kapitaniak2012", "chen2008", "venzon1988"]
    assert "Version 1.2.3" in references[0].text


def test_friction_and_the_kind_of_interval_are_cited() -> None:
    found = {"chi": Parameter(0.6, 0.5, 0.7, 0.95, True, False), "mu": Parameter(0.2, 0.1, 0.3, 0.95, True, False)}
    fit = made.fit(parameters=found, chosen=("friction",), choices=Choices("bootstrap"))
    paragraphs, references = methods_text(made.record(fit=fit), ReportDetails())
    assert "The model includes friction." in paragraphs[1]
    assert "[3]; χ² is the ratio of the work" in paragraphs[1]
    assert "bootstrap of the residuals [4], is χ = 0.60" in paragraphs[1]
    assert ", μ = 0.20" in paragraphs[1]
    assert [reference.key for reference in references][2:] == ["stronge1990", "buhlmann1997"]


def test_the_law_that_follows_no_course_of_the_slip_has_a_source_of_its_own() -> None:
    found = {"chi": Parameter(0.6, 0.5, 0.7, 0.95, True, False), "mu": Parameter(0.2, 0.1, 0.3, 0.95, True, False)}
    fit = replace(made.fit(parameters=found, chosen=("friction",)), restitution="algebraic")
    paragraphs, references = methods_text(made.record(fit=fit), ReportDetails())
    assert "law of Chatterjee and Ruina [3]; χ is the ratio of the normal velocities" in paragraphs[1]
    assert "along the normal impulse" not in paragraphs[1]
    assert references[2].key == "chatterjee1998"


def test_what_is_not_known_is_not_said() -> None:
    track = made.track()
    unknown = replace(track, covariance=np.full_like(track.covariance, np.nan))
    record = made.record(track=unknown, fit=None, measured=Throw(made.throw().flights[:1], ()))
    paragraphs, references = methods_text(record, ReportDetails())
    assert len(paragraphs) == 1
    assert not re.search("nan|None|standard error|impact", paragraphs[0])
    assert [reference.key for reference in references] == ["diethrow"]


def test_a_track_without_a_camera_is_not_said_to_be_measured_by_this_program() -> None:
    paragraphs, _ = methods_text(made.record(camera=None, clip=None), ReportDetails())
    assert "Its pose is given on 53 of the 57 frames that show it, and was analysed with diethrow [1]." in paragraphs[0]


def test_bibtex_has_an_entry_for_each_reference_with_balanced_braces() -> None:
    references = methods_text(made.record(), ReportDetails())[1]
    text = bibtex(references)
    assert re.findall(r"^@\w+\{(\w+),$", text, re.MULTILINE) == [reference.key for reference in references]
    assert text.count("{") == text.count("}")


def test_every_source_of_error_that_a_fit_names_has_a_name() -> None:
    assert set(SHARES["chi"]) == set(SOURCES)
    assert share_words({"noise": 0.2, "clock": 0.8}) == "80 % frame rate, 20 % noise of the frames"
    html = sources_html(made.fit(variance_shares=SHARES))
    assert sum(float(width) for width in re.findall(r"width:([\d.]+)%", html)) == pytest.approx(100.0, abs=0.1)
    assert sources_html(made.fit()) == ""


def test_the_tables_are_saved_byte_for_byte_from_the_page() -> None:
    table = 'x_m,"a"\n0.1,é\n'
    page = report_page(made.record(), ReportDetails(tables={"track.csv": table}))
    names = re.findall('download="([^"]*)" href="data:[^;]*;base64,([^"]*)"', page)
    assert [name for name, _ in names] == ["track.csv", "references.bib"]
    assert base64.b64decode(names[0][1]).decode() == table


def test_a_large_table_stays_beside_the_page() -> None:
    html = downloads_html({"track.csv": "x" * (MOST_BYTES + 1)})
    assert "href" not in html
    assert "track.csv (2000 kB), in the folder of this page" in html
    assert downloads_html({}) == ""
