"""
A throw as the model makes it
=============================

The height of every corner of a cube that falls from 30 cm, as in Fig. 5 of the paper: smooth impacts above, and the same release
with friction below.
"""

import matplotlib.pyplot as plt
import numpy as np

from diethrow.model import CoulombImpact, SmoothImpact, State, make_die, throw_die
from diethrow.replay.figures.throw_plots import throw_heights

die = make_die("cube", edge_m=0.02, mass_kg=0.016)
release = State(0.0, np.array([0, 0, 0.3]), np.array([1.0, 0, 0, 0]), np.array([0.6, 0, -0.7]), np.array([3.0, 40, 2]))

figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
laws = {"χ = 0.5, no friction": SmoothImpact(0.5), "χ = 0.5, μ = 0.2": CoulombImpact(0.5, 0.2)}
for ax, (name, law) in zip(axes, laws.items(), strict=True):
    result = throw_die(die, release, law)
    throw_heights(ax, die.solid, result.throw)
    ax.set_title(f"{name}: {result.impact_count} impacts, face {result.landed_face}", fontsize=10)
plt.show()
