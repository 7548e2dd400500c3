"""Fitting: from a track to the model that explains it, by free flights, single bounces, and the whole throw.

`fit_throw` returns χ and the initial conditions with intervals; `apparent_restitution` measures a single bounce.
Folders: `estimation` (observations, robust least squares, intervals), `free` (what needs no impact law), `throw` (one
throw against the model), `dataset` (joint fits of many throws), `predict` (predictions and sequential estimates).
"""

from .free import Bounce as Bounce
from .free import apparent_restitution as apparent_restitution
from .results import Effect as Effect
from .results import Fit as Fit
from .results import Parameter as Parameter
from .throw import fit_throw as fit_throw
