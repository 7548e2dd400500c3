"""
A throw on film
===============

The sample clip, analysed: half a minute.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import diethrow as dt

root = Path.cwd()
while not (root / "data_samples").is_dir():
    root = root.parent
throw = dt.analyze(root / "data_samples/cube_wood/scene.toml")
print(throw)
print(throw.parameters[["value", "low", "high", "unit"]])

# %%
# The impacts as a table.
print(throw.bounces[["t_s", "vertices", "normal_velocity_before_m_s", "chi", "chi_low", "chi_high"]])

# %%
# The whole throw in one picture: measured edges blue, simulated orange.
throw.plot.stroboscope()
plt.show()

# %%
# Experiment over model: the height of every corner.
throw.plot.heights()
plt.show()

# %%
# χ of every bounce by itself, and the fitted one.
throw.plot.bounces()
plt.show()

# %%
# What is left, frame by frame, in standard errors.
throw.plot.residuals()
plt.show()

# %%
# How the fitted initial conditions go together.
throw.plot.correlation()
plt.show()

# %%
# The same throw fitted without any effect on trial, and predicted from its first flight alone.
print(throw.fit(effects=()).parameters["value"])
predicted = throw.predict()
print(predicted.loc[predicted.status == "tracked", ["x_m", "y_m", "z_m", "sigma_z_m"]].iloc[-3:])

# %%
# Where the die would land.
throw.plot.landing()
plt.show()
