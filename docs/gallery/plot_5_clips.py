"""
Dice on film
============

Clips of a tetrahedron on wood, an icosahedron on cork, and a cube on a mirror, each analysed as it is. Blue edges are measured,
orange ones simulated with the fitted law.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import diethrow as dt

root = Path.cwd()
while not (root / "data_samples").is_dir():
    root = root.parent

# %%
# The tetrahedron: plain faces, so that only its edges show how it turns.
tetrahedron = dt.analyze(root / "data_samples/tetrahedron_wood/scene.toml")
tetrahedron.plot.stroboscope()
plt.show()
print(tetrahedron)

# %%
# The icosahedron, with numbers on its faces.
icosahedron = dt.analyze(root / "data_samples/icosahedron_cork/scene.toml")
icosahedron.plot.stroboscope()
plt.show()
print(icosahedron)

# %%
# The cube. The mirror shows it a second time, which is a second view of the same pose.
cube = dt.analyze(root / "data_samples/cube_mirror/scene.toml")
cube.plot.stroboscope()
plt.show()
print(cube)

# %%
# Experiment over model for all three: height of every corner.
figure, axes = plt.subplots(3, 1, figsize=(8, 9), layout="constrained")
for ax, one in zip(axes, (tetrahedron, icosahedron, cube), strict=True):
    one.plot.heights(ax)
    ax.set_title(one.record.title, fontsize=10)
plt.show()
