"""Mutated files are read or refused with a message: a short run; `benchmarks/fuzz.py` makes long ones."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from fuzz_targets import Target, mutated, targets
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

NAMES = ("cih", "cihx", "cine", "tiff", "scene", "throw", "track", "covariance", "bounces", "fit")
EACH = int(os.environ.get("DIETHROW_FUZZ", "60"))
"""Mutated files of each kind, and as many from hypothesis."""


@pytest.fixture(scope="module")
def by_name(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Target]]:
    folder = tmp_path_factory.mktemp("fuzz")
    return {target.name: (folder, target) for target in targets(folder)}


@pytest.mark.parametrize("name", NAMES)
def test_mutated_files_are_read_or_refused(by_name: dict[str, tuple[Path, Target]], name: str) -> None:
    folder, target = by_name[name]
    random = np.random.default_rng(12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numbers near the largest may overflow before they are refused
        for content in target.seeds:
            target.read(folder, content)
        for _ in range(EACH):
            target.read(folder, mutated(target, random))


@pytest.mark.parametrize("name", NAMES)
def test_files_of_random_parts_are_read_or_refused(by_name: dict[str, tuple[Path, Target]], name: str) -> None:
    folder, target = by_name[name]
    parts = st.one_of(st.sampled_from([*target.words, *target.seeds]), st.binary(max_size=40))

    @settings(
        max_examples=EACH, deadline=10_000, derandomize=True, suppress_health_check=list(HealthCheck), database=None
    )
    @given(before=parts, cut=st.integers(0, 6000), word=parts, after=st.integers(0, 6000))
    def read(before: bytes, cut: int, word: bytes, after: int) -> None:
        target.read(folder, before[:cut] + word + before[cut + after % 64 :])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read()


def test_a_header_that_declares_a_terabyte_is_refused(by_name: dict[str, tuple[Path, Target]], tmp_path: Path) -> None:
    from diethrow.files.throw_records import read_track
    from diethrow.tracking.footage.clip import open_clip

    _, target = by_name["cih"]
    header = (
        target.seeds[0]
        .replace(b"Image Width : 8", b"Image Width : 1048576")
        .replace(b"Height : 6", b"Height : 1048576")
    )
    (tmp_path / "a.cih").write_bytes(header)
    (tmp_path / "a.mraw").write_bytes(bytes(1000))
    with pytest.raises(ValueError, match="1048576 × 1048576 px"):
        open_clip(tmp_path / "a.cih", fps=1500.0)
    # Frames of one pixel, and a hole of a terabyte that takes no room on the disk.
    (tmp_path / "a.cih").write_bytes(
        target.seeds[0].replace(b"Width : 8", b"Width : 2").replace(b"Height : 6", b"Height : 1")
    )
    with (tmp_path / "a.mraw").open("r+b") as file:
        file.truncate(2**40)
    content = (tmp_path / "a.cih").read_bytes().replace(b"Total Frame : 3", b"Total Frame : 300000000000")
    (tmp_path / "a.cih").write_bytes(content)
    with pytest.raises(ValueError, match="declares 300000000000 frames"):
        open_clip(tmp_path / "a.cih", fps=1500.0)
    # A covariance of a terabyte beside a track of three frames.
    (tmp_path / "t.csv").write_bytes(by_name["track"][1].seeds[0])
    content = by_name["covariance"][1].seeds[0]
    (tmp_path / "t_covariance.npy").write_bytes(content.replace(b"(3, 6, 6), }         ", b"(4000000000, 6, 6), }"))
    with pytest.raises(ValueError, match=r"shape \(4000000000, 6, 6\)"):
        read_track(tmp_path / "t.csv")
