"""The rigid-impact die: solids, exact flight, impacts, and throws simulated event by event.

die = make_die("cube", edge_m=0.02, mass_kg=0.016)
result = throw_die(die, release, SmoothImpact(chi=0.5))
"""

from .die import Die as Die
from .die import Solid as Solid
from .die import convex_solid as convex_solid
from .die import die_from_solid as die_from_solid
from .die import loaded_die as loaded_die
from .die import make_die as make_die
from .die import truncated_dipyramid as truncated_dipyramid
from .laws import CoulombImpact as CoulombImpact
from .laws import FrictionBySpeed as FrictionBySpeed
from .laws import ImpactLaw as ImpactLaw
from .laws import RestitutionBySpeed as RestitutionBySpeed
from .laws import SmoothImpact as SmoothImpact
from .laws import Table as Table
from .throw import Ending as Ending
from .throw import Flight as Flight
from .throw import Impact as Impact
from .throw import Precision as Precision
from .throw import State as State
from .throw import Throw as Throw
from .throw import ThrowResult as ThrowResult
from .throw import Until as Until
from .throw import throw_die as throw_die
