"""Many throws, and the growth of errors in one: odds, basins, predictability, chaos, and time stepping for comparison.

`ThrowSetup` throws from an array of releases and returns how each throw ended. On it rest `tally_throws` for the odds
of the faces, `map_rows` for basins of attraction, and the sensitivity and fairness of `predictability`. `error_growth`,
`decidable_in_double_precision` and `largest_lyapunov_exponent` use the derivative of single throws. `stepped_landings`
throws as a time-stepping engine does.
"""

from .basins import FIG_6_CONDITIONS as FIG_6_CONDITIONS
from .basins import Axis as Axis
from .basins import Window as Window
from .basins import final_configurations as final_configurations
from .basins import map_rows as map_rows
from .chaos import ErrorGrowth as ErrorGrowth
from .chaos import LyapunovExponents as LyapunovExponents
from .chaos import decidable_in_double_precision as decidable_in_double_precision
from .chaos import error_growth as error_growth
from .chaos import largest_lyapunov_exponent as largest_lyapunov_exponent
from .landings import ENDING_OF_INDEX as ENDING_OF_INDEX
from .landings import ThrowSetup as ThrowSetup
from .landings import chunks_in_order as chunks_in_order
from .odds import Share as Share
from .odds import Tally as Tally
from .odds import check_releases as check_releases
from .odds import tally_throws as tally_throws
from .predictability import Fairness as Fairness
from .predictability import FinalStateSensitivity as FinalStateSensitivity
from .predictability import UncertaintyExponent as UncertaintyExponent
from .predictability import fairness_by_dynamics as fairness_by_dynamics
from .predictability import final_state_sensitivity as final_state_sensitivity
from .predictability import uncertainty_exponent as uncertainty_exponent
from .releases import BLOCK as BLOCK
from .releases import CONDITIONS as CONDITIONS
from .releases import HEIGHT_EDGES as HEIGHT_EDGES
from .releases import Conditions as Conditions
from .releases import PaperConditions as PaperConditions
from .releases import UniformConditions as UniformConditions
from .releases import drawn_states as drawn_states
from .releases import states_of as states_of
from .stepping import stepped_landings as stepped_landings
