"""What a die is: its solid, mass, inertia, rounded corners and symmetries.

`make_die` gives one of the five isohedral dice, `die_from_solid` and `loaded_die` those of any `named_solid`; all others take
a `Die`.
`Solid` holds the sharp polyhedron, `inner_vertices` the corners under the rounding. The symmetry rotations serve
whatever compares the orientations of an unmarked die.
"""

from .die import MAX_CORNER_RADIUS_FRACTION as MAX_CORNER_RADIUS_FRACTION
from .die import Die as Die
from .die import die_from_solid as die_from_solid
from .die import loaded_die as loaded_die
from .die import make_die as make_die
from .named_solids import MESH_SUFFIXES as MESH_SUFFIXES
from .named_solids import SOLID_KINDS as SOLID_KINDS
from .named_solids import SolidKind as SolidKind
from .named_solids import named_solid as named_solid
from .named_solids import solid_from_mesh as solid_from_mesh
from .named_solids import truncated_dipyramid as truncated_dipyramid
from .solid import INSPHERE_TOLERANCE as INSPHERE_TOLERANCE
from .solid import SHAPES as SHAPES
from .solid import Solid as Solid
from .solid import convex_solid as convex_solid
from .solid import inner_vertices as inner_vertices
from .solid import largest_corner_radius as largest_corner_radius
from .solid import lowest_face as lowest_face
from .solid import numbered_solid as numbered_solid
from .symmetry import die_symmetries as die_symmetries
from .symmetry import inversion_rotation as inversion_rotation
from .symmetry import nearest_equivalent_rotation as nearest_equivalent_rotation
from .symmetry import symmetry_rotations as symmetry_rotations
