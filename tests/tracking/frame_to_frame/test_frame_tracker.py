"""Laws of the tracker from one frame to the next."""

from __future__ import annotations

from cube_seen_late import SEEN_FROM, cube_seen_late, off_m


def test_tracking_backwards_goes_through_an_impact() -> None:
    _, source, tracker, poses, throw = cube_seen_late()
    back = tracker.backwards_tracker()
    for block in source.blocks_backwards(SEEN_FROM):
        with block:
            back.track(block.frames, source.times_s, block.first, poses)
    assert poses.known[:SEEN_FROM].all()
    assert off_m(poses, throw)[:SEEN_FROM].max() < 1e-3
