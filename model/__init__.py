"""The rigid-impact die: solids, exact flight, impacts, and throws simulated event by event.

die = make_die("cube", edge_m=0.02, mass_kg=0.016)
result = throw_die(die, release, SmoothImpact(chi=0.5))
"""

from .impacts import CoulombImpact as CoulombImpact
from .impacts import FrictionBySpeed as FrictionBySpeed
from .impacts import ImpactLaw as ImpactLaw
from .impacts import RestitutionBySpeed as RestitutionBySpeed
from .impacts import SmoothImpact as SmoothImpact
from .motion import Flight as Flight
from .motion import Impact as Impact
from .motion import State as State
from .motion import Throw as Throw
from .simulate import Ending as Ending
from .simulate import Precision as Precision
from .simulate import ThrowResult as ThrowResult
from .simulate import Until as Until
from .simulate import throw_die as throw_die
from .solids import Die as Die
from .solids import Solid as Solid
from .solids import convex_solid as convex_solid
from .solids import die_from_solid as die_from_solid
from .solids import loaded_die as loaded_die
from .solids import make_die as make_die
from .solids import truncated_dipyramid as truncated_dipyramid
from .tables import Table as Table
