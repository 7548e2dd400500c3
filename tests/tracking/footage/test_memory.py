"""Memory does not grow with the length of a film."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_cine, write_photron, write_tiff, write_video

READ = """
import resource, sys
from pathlib import Path
from diethrow.tracking.footage import open_clip
path, fps = Path(sys.argv[1]), float(sys.argv[2])
clip = open_clip(path, fps=fps)
for _ in clip.frames(0, 20): pass
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for _ in clip.frames(): pass
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the unit of ru_maxrss is the kilobyte on Linux only")
@pytest.mark.parametrize("kind", ["H.264", "TIFF", "Photron", "Phantom"])
def test_reading_a_film_takes_no_more_memory_than_reading_its_beginning(kind: str, tmp_path: Path) -> None:
    frames = np.tile(noisy_frames(20, bits=12, height=256, width=320), (20, 1, 1))  # 400 frames, 65 MB
    path = {
        "H.264": lambda: write_video(
            tmp_path / "x.mp4", (frames >> 4).astype(np.uint8), codec="libx264", options={"preset": "ultrafast"}
        ),
        "TIFF": lambda: write_tiff(tmp_path / "x.tif", frames),
        "Photron": lambda: write_photron(tmp_path / "x.cihx", frames, stored_bits=12),
        "Phantom": lambda: write_cine(tmp_path / "x.cine", frames, stored_bits=12),
    }[kind]()
    run = subprocess.run([sys.executable, "-c", READ, str(path), "1500"], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 12_000  # kB: the frames in flight of the decoder, well below the 33 to 65 MB of the film
