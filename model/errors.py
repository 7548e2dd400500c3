"""Errors that a user can mend: an input, a setting, a place for the output. Every other exception is a fault of the program."""

from __future__ import annotations


class DiethrowError(Exception):
    """What a user can mend; its text says what was got, what was wanted, and what to try."""


class InputError(DiethrowError, ValueError):
    """A value, a file or footage that cannot be used as it is."""
