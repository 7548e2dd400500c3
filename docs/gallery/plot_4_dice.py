"""
Throws of all dice
==================

Eight dice of about the same size fall from 12 cm, spinning, and come to rest. Press *Play*; drag to turn the view.
"""

import diethrow as dt
from diethrow.model.die import die_from_solid, named_solid

law = dt.SmoothImpact(0.5)
release = dt.State(0.0, [0.0, 0.0, 0.12], [0.8, 0.3, 0.4, 0.2], [0.25, 0.1, -0.3], [25.0, -18.0, 12.0])


def thrown(shape: str, **lengths: object) -> dt.SimulatedThrow:
    """A die of this shape, of 5 g, thrown until it rests."""
    return dt.throw(die_from_solid(named_solid(shape, **lengths), 0.005), law, release)


# %%
# The tetrahedron.
thrown("tetrahedron", edge_m=0.024)

# %%
# The cube.
thrown("cube", edge_m=0.016)

# %%
# The octahedron.
thrown("octahedron", edge_m=0.020)

# %%
# The dodecahedron.
thrown("dodecahedron", edge_m=0.0095)

# %%
# The icosahedron.
thrown("icosahedron", edge_m=0.0135)

# %%
# A d10: a pentagonal trapezohedron.
thrown("d10", edge_m=0.016, short_edge_m=0.0075)

# %%
# A cuboid, as a book or a brick.
thrown("cuboid", edges_m=[0.012, 0.0144, 0.018])

# %%
# A dipyramid of five sides with cut tips.
thrown("dipyramid", sides=5, radius_m=0.012, half_height_m=0.018, cut=0.4)
