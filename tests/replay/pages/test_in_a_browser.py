"""The report in a real browser, opened from a file without a network: no error, no request, and everything is drawn."""

from __future__ import annotations

import base64
import re
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import replay_records as made
from browser import Page, opened

from diethrow.replay.pages.embedded_viewer import viewer_files
from diethrow.replay.pages.report import throw_page, write_report
from diethrow.replay.recording.throw_recording import write_recording, write_throw_recording

PHONE_PX = 390
PLOTS = "figure .wide > svg"
DECODE_PHOTOGRAPHS = """
Promise.all(Array.from(document.querySelectorAll("svg image"), (photograph) => {
  const image = new Image();
  image.src = photograph.href.baseVal;
  return image.decode();
})).then((all) => all.length)
"""
"""Photographs in an SVG do not report whether they were decoded; an element with the same address does."""
HOSTILE = "</script></style><script>window.fooled = 1</script><img src=x onerror='window.fooled = 1'>"
START_TIMEOUT_S = 60.0
DRAW_TIMEOUT_S = 60.0
"""With one core for drawing, the viewer starts within 4 s and draws within 10 s; the machine may have other work."""


def check_quiet(page: Page, file: Path) -> None:
    """Assert that the console has no error and only the page was requested."""
    assert page.errors == []
    assert page.requests == [file.resolve().as_uri()]


def test_the_report_opens_from_a_file_and_fits_a_phone(tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    fit = made.fit(messages=(HOSTILE,))
    write_report(file, made.record(title=HOSTILE, notices=(HOSTILE,), fit=fit))
    with opened(file.as_uri(), tmp_path / "browser", width_px=PHONE_PX, height_px=844) as page:
        plots = page.evaluate(f"Array.from(document.querySelectorAll({PLOTS!r}), (svg) => svg.getBBox().width)")
        assert len(plots) >= 6
        assert min(plots) > PHONE_PX / 2
        assert page.evaluate(DECODE_PHOTOGRAPHS) > 2
        # Wide figures and tables scroll on their own; the page does not.
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE_PX
        assert page.evaluate("typeof window.fooled") == "undefined"
        check_quiet(page, file)


def test_the_embedded_replay_opens_from_a_file_and_is_drawn(tmp_path: Path) -> None:
    recording, file = tmp_path / "replay.rrd", tmp_path / "report.html"
    record = made.record()
    write_recording(recording, record)
    write_report(file, record, replay=recording)
    with opened(file.as_uri(), tmp_path / "browser", width_px=480, height_px=360) as page:
        page.evaluate("document.getElementById('replay-start').click()")
        page.wait_for("document.getElementById('replay').dataset.state === 'started'", START_TIMEOUT_S)
        page.evaluate("document.getElementById('replay-canvas').scrollIntoView()")
        assert is_drawn(page)
        assert page.evaluate("document.getElementById('replay-status').textContent") == ""
        check_quiet(page, file)


def is_drawn(page: Page) -> bool:
    """Whether the view has many colours within DRAW_TIMEOUT_S; an empty canvas has one."""
    until = time.monotonic() + DRAW_TIMEOUT_S
    while time.monotonic() < until:
        picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        if len(np.unique(picture.reshape(-1, 3), axis=0)) > 100:
            return True
    return False


def test_the_viewer_is_the_installed_one() -> None:
    script, code = viewer_files()
    assert b"wasm_bindgen" in script
    assert code.startswith(b"\0asm")


def test_the_page_of_a_simulated_throw_contains_its_recording(tmp_path: Path) -> None:
    recording = tmp_path / "replay.rrd"
    write_throw_recording(recording, made.die(), made.throw(), made.FPS, "a throw")
    text = throw_page(HOSTILE, made.die(), made.throw(), made.FPS, (HOSTILE,), recording)
    packed = re.search('id="viewer-recording">([^<]*)</script>', text)
    assert packed is not None
    assert base64.b64decode(packed[1]) == recording.read_bytes()
    assert "window.fooled = 1</script>" not in text
    assert "bounce 1 at 23.457 ms, vertex 0" in text


def test_a_page_without_a_recording_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_report(tmp_path / "report.html", made.record(), replay=tmp_path / "none.rrd")
    assert not (tmp_path / "report.html").exists()
