"""Speed against accuracy: reported figures are the measured ones; the recommended setting is fast and accurate enough."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diethrow.commands.clip import analyze as analyses
from diethrow.commands.clip import trade as trades
from diethrow.commands.clip.trade import read_trade, setting_for, trade
from diethrow.files.provenance import InputChangedError
from diethrow.files.scene import read_scene
from diethrow.replay.pages.trade import Setting, Trade, fastest_within, trade_page
from diethrow.tracking.footage.decimation import Decimation
from diethrow.tracking.quality import QUALITIES

SAMPLE = Path(__file__).parents[2] / "data_samples" / "cube_wood" / "scene.toml"


def setting(name: str, rate: float, half_width: float | None, off: float = 0.0) -> Setting:
    if half_width is None:
        return Setting("tracking", name, rate, 1.0 / rate, None, why_not="χ stays open.")
    options = ("--quality", name)
    return Setting(
        "tracking", name, rate, 1.0 / rate, 0.01, 0.5, 0.5 - half_width, 0.5 + half_width, off, options=options
    )


def test_the_fastest_sufficient_setting_is_recommended() -> None:
    tried = [setting("fast", 9.0, 0.02), setting("standard", 5.0, 0.008), setting("fine", 1.0, 0.001)]
    assert fastest_within(tried, 0.01) is tried[1]
    assert fastest_within(tried, 0.05) is tried[0]
    assert fastest_within(tried, 1e-4) is None


def test_a_narrow_interval_far_from_the_reference_is_insufficient() -> None:
    wrong, right = setting("fast", 9.0, 0.001, off=0.05), setting("fine", 1.0, 0.002)
    assert fastest_within([wrong, right], 0.01) is right


def test_no_setting_on_the_front_is_dominated() -> None:
    random = np.random.default_rng(1)
    tried = [setting(str(k), random.uniform(1, 9), random.uniform(1e-3, 1e-1)) for k in range(30)]
    tried += [setting("open", 20.0, None)]
    marked = trades.with_front(tried, lambda s: s.chi_uncertainty)
    for one in marked:
        beaten = any(
            other.chi_uncertainty is not None
            and one.chi_uncertainty is not None
            and other.rate > one.rate
            and other.chi_uncertainty < one.chi_uncertainty
            for other in marked
        )
        assert one.on_front == (one.chi_uncertainty is not None and not beaten)


def test_the_advice_names_options_or_states_that_none_suffices() -> None:
    tried = (setting("fast", 9.0, 0.02), setting("standard", 5.0, 0.008))
    assert "--quality standard" in Trade(tried, "the finest run", 0.01).advice
    assert Trade(tried, "the finest run", 0.001).advice.startswith("No setting gives χ to ±0.001")


def test_a_page_escapes_text() -> None:
    hostile = replace(setting("fast", 9.0, 0.02), name="<script>alert(1)</script>", on_front=True)
    page = trade_page("<b>", Trade((hostile,), "the finest run", 0.01))
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Trade, Path]:
    """A short ladder on a sample, with one simulated track and few throws."""
    out = tmp_path_factory.mktemp("trade") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trades, "LADDER", (("fast", 4, 2), ("fast", 1, 1)))
        patch.setattr(trades, "FIRST_OF_LADDER", ("fast", 4, 2))
        patch.setattr(trades, "WORK", trades.WORK[6:7])
        patch.setattr(trades, "THROWS", 20)
        patch.setattr(trades, "STEPS_S", (1e-3,))
        return trade(read_scene(SAMPLE), out, draws=1), out


def test_every_trade_is_measured(measured: tuple[Trade, Path]) -> None:
    found, _ = measured
    assert [len(found.of(kind)) for kind in ("tracking", "work", "fit", "model")] == [2, 1, 4, 5]
    for s in (*found.of("tracking"), *found.of("work")):
        assert s.rate > 0.0
        assert s.chi == pytest.approx(0.5829, abs=0.02)
    exact = found.of("model")[0]
    assert exact.error == 0.0
    assert {s.coverage for s in found.of("fit")} <= {0.0, 1.0}


def test_measurements_are_written_and_read_back(measured: tuple[Trade, Path]) -> None:
    found, out = measured
    assert read_trade(out / "trade.json") == found.settings
    assert json.loads((out / "trade.json").read_text("utf-8"))["advice"] == found.advice
    names = {path.name for path in out.iterdir()}
    assert {"trade.csv", "trade.html", "tracking.png", "tracking.svg", "model.png", "provenance.json"} <= names


def test_a_setting_is_chosen_from_measurements(measured: tuple[Trade, Path]) -> None:
    found, out = measured
    best = fastest_within(found.of("tracking"), 0.3)
    assert best is not None
    chosen = setting_for(read_scene(SAMPLE), 0.3, out / "trade.json")
    assert (chosen.quality, chosen.decimation, chosen.tracked) == (*best.choice, None)
    assert best.choice in {("fast", Decimation(4, 2)), ("fast", Decimation(1, 1))}
    with pytest.raises(ValueError, match="no setting in it gives χ"):
        setting_for(read_scene(SAMPLE), 1e-9, out / "trade.json")


def test_a_clip_that_was_tracked_to_choose_a_setting_is_not_tracked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The results are those of an analysis with that setting alone."""
    scene = read_scene(SAMPLE)
    monkeypatch.setattr(trades, "LADDER", (("fast", 4, 2),))
    chosen = setting_for(scene, 0.9)
    assert chosen.tracked is not None
    options: dict[str, Any] = {"quality": QUALITIES[chosen.quality], "decimation": chosen.decimation}
    analyses.analyze(scene, tmp_path / "alone", **options)
    monkeypatch.setattr(analyses, "track_scene", None)
    analyses.analyze(scene, tmp_path / "reused", tracked=chosen.tracked, **options)
    for name in ("track.csv", "track_frames.csv", "bounces.csv", "fit.json"):
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "reused" / name).read_bytes(), name


def test_a_clip_that_changed_since_a_setting_was_chosen_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "scene"
    shutil.copytree(SAMPLE.parent, folder)
    scene = read_scene(folder / "scene.toml")
    monkeypatch.setattr(trades, "LADDER", (("fast", 4, 2),))
    chosen = setting_for(scene, 0.9)
    with (folder / "scene.toml").open("a") as file:
        file.write("\n# another\n")
    with pytest.raises(InputChangedError, match=r"scene\.toml"):
        analyses.analyze(scene, tmp_path / "out", tracked=chosen.tracked, decimation=chosen.decimation)
    assert not (tmp_path / "out").exists()


def test_another_json_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "trade.json"
    path.write_text('{"settings": [{"kind": "tracking"}]}', encoding="utf-8")
    with pytest.raises(ValueError, match="not a trade file"):
        read_trade(path)


def test_an_impossible_width_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="within = 0"):
        trade(read_scene(SAMPLE), tmp_path / "out", within=0.0)
