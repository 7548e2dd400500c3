"""tracking.check."""

from .clip_quality import Preflight as Preflight
from .clip_quality import Sight as Sight
from .clip_quality import contacts_of as contacts_of
from .clip_quality import fall_of as fall_of
from .clip_quality import preflight as preflight
from .clip_quality import timing_of as timing_of
from .gravity import fall_notices as fall_notices
from .gravity import measure_fall as measure_fall
from .verdicts import Finding as Finding
from .verdicts import Verdict as Verdict
from .verdicts import judge as judge
from .verdicts import judge_throw as judge_throw
