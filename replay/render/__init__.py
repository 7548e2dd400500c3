"""replay.render."""

from .film import Effort as Effort
from .film import Studio as Studio
from .film import film_light as film_light
from .film_set import Look as Look
from .film_set import lamp_beside as lamp_beside
from .sensor import FixedPattern as FixedPattern
from .sensor import Sensor as Sensor
from .sensor import expose as expose
from .sensor import fixed_pattern as fixed_pattern
from .sensor import rounded as rounded
