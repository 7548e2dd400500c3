"""The rigid-impact die: solids, exact flight, impacts, and throws simulated event by event.

die = make_die("cube", edge_m=0.02, mass_kg=0.016)
result = throw_die(die, release, SmoothImpact(chi=0.5))
"""

from .impacts import ImpactLaw as ImpactLaw
from .impacts import SmoothImpact as SmoothImpact
from .motion import Flight as Flight
from .motion import Impact as Impact
from .motion import State as State
from .motion import Throw as Throw
from .simulate import Ending as Ending
from .simulate import ThrowResult as ThrowResult
from .simulate import Until as Until
from .simulate import throw_die as throw_die
from .solids import Die as Die
from .solids import Solid as Solid
from .solids import make_die as make_die
