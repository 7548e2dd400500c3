"""
A throw on film
===============

The sample clip, analysed: half a minute. What ``diethrow analyze`` writes with ``--figures`` are these pictures.
"""

import tempfile
from pathlib import Path

import matplotlib.image as image
import matplotlib.pyplot as plt

from diethrow.analysis import Shown
from diethrow.commands.clip.analyze import analyze
from diethrow.files.scene import read_scene

root = Path.cwd()
while not (root / "data_samples").is_dir():
    root = root.parent
folder = Path(tempfile.mkdtemp()) / "cube_wood"
result = analyze(read_scene(root / "data_samples/cube_wood/scene.toml"), folder, shown=Shown(figures=True))
chi = result.fit.parameters["chi"]
print(
    f"χ = {chi.value:.5f}, 95 % interval {chi.low:.5f} to {chi.high:.5f}; {result.fit.bounces_fitted} bounces explained"
)


def show(name):
    """A figure as it was written."""
    picture = image.imread(folder / "figures" / f"{name}.png")
    figure = plt.figure(figsize=(picture.shape[1] / 200, picture.shape[0] / 200), dpi=200)
    figure.add_axes((0, 0, 1, 1)).imshow(picture)
    figure.axes[0].set_axis_off()
    plt.show()


# %%
# The whole throw in one picture, and each bounce frame by frame: measured edges blue, simulated orange.
show("stroboscope")

# %%
show("bounces")

# %%
# Experiment over model: the height of every corner.
show("heights")

# %%
# χ of every bounce by itself, and the fitted one.
show("restitution")

# %%
# What is left, frame by frame, in standard errors.
show("residuals_position_sigmas")

# %%
# How the fitted initial conditions go together.
show("correlations")

# %%
# Where the die would land.
show("odds")
