"""From a track to the model that explains it: free flights, bounces one by one, and the whole throw at once.

`fit_throw` gives χ and the initial conditions with intervals; `apparent_restitution` looks at a single bounce.
"""

from .free import Bounce as Bounce
from .free import apparent_restitution as apparent_restitution
from .results import Effect as Effect
from .results import Fit as Fit
from .results import Parameter as Parameter
from .throw import fit_throw as fit_throw
