"""Every example in a docstring of the interface runs."""

from __future__ import annotations

import doctest
from importlib import import_module

import pytest

MODULES = ("diethrow", "diethrow.interface.analysis", "diethrow.interface.simulations", "diethrow.interface.tables")


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_give_what_they_say(name: str) -> None:
    found = doctest.testmod(import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted
    assert found.failed == 0
