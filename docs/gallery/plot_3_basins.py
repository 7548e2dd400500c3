"""
Which face, over a plane of initial conditions
==============================================

A tetrahedron that loses nearly everything at each impact (χ = 0.2), by its height and its spin at the release: the
paper's Fig. 6. Every pixel is one throw.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from diethrow.commands.model.basin_maps import BasinsPlan, axes_of, basins
from diethrow.replay.figures.ensembles import basin_map

x, y = axes_of(("z0", 0.1, 0.4), ("omega_eta", 0.0, 50.0), None, (300, 200))
plan = BasinsPlan(x, y)
mapped, _ = basins(plan, Path(tempfile.mkdtemp()) / "basins")

figure, ax = plt.subplots(figsize=(8, 5), layout="constrained")
basin_map(ax, plan.x, plan.y, mapped.face, mapped.ending, faces=4)
plt.show()
