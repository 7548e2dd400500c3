"""replay.render."""

from .mitsuba_scene import Look as Look
from .mitsuba_scene import lamp_beside as lamp_beside
from .renderer import Effort as Effort
from .renderer import Studio as Studio
from .renderer import film_light as film_light
from .sensor import FixedPattern as FixedPattern
from .sensor import Sensor as Sensor
from .sensor import expose as expose
from .sensor import fixed_pattern as fixed_pattern
from .sensor import rounded as rounded
