"""What holds for every test."""

from __future__ import annotations

from contextlib import nullcontext

import pytest


@pytest.fixture(autouse=True)
def kernels_are_compiled_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which test meets a cold cache is chance, and many count the lines of what is said."""
    monkeypatch.setattr("diethrow.compiling.announced", lambda say: nullcontext())
    monkeypatch.setattr("diethrow.compiling.model_ahead", nullcontext)
    monkeypatch.setattr("diethrow.compiling.is_compiled", lambda: True)
