"""Many throws of one die on one table: a joint fit of the parameters that they share.

`entry_of` prepares a track, `fit_jointly` finds the parameters, with bootstrap intervals, and the effects that predict
left-out throws better. The command `fit` uses it for several tracks.
"""

from .data_set import Entry as Entry
from .data_set import entry_of as entry_of
from .joint_fit import JointFit as JointFit
from .joint_fit import PredictedThrow as PredictedThrow
from .joint_fit import fit_jointly as fit_jointly
