"""fitting.dataset."""

from .data_set import Entry as Entry
from .data_set import entry_of as entry_of
from .joint_fit import Foretold as Foretold
from .joint_fit import JointFit as JointFit
from .joint_fit import fit_jointly as fit_jointly
