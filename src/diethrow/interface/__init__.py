"""What `import diethrow` offers beside the stages: an analysis as a value, and the model alone, for notebooks and scripts.

`analyze` and `load` make an `Analysis`; `throw`, `odds` and `basins` are the model without files. Everything that needs pandas,
matplotlib or Rerun imports it when it is first asked for.
"""

from .analysis import Analysis as Analysis
from .analysis import analyze as analyze
from .analysis import load as load
from .analysis import to_xarray as to_xarray
from .simulations import Basins as Basins
from .simulations import Odds as Odds
from .simulations import SimulatedThrow as SimulatedThrow
from .simulations import basins as basins
from .simulations import odds as odds
from .simulations import throw as throw
