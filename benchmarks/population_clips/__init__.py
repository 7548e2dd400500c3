"""Random clips with their truth, for statistics over a population: what is drawn, and its pictures.

`draw` chooses a throw, a die, its light, a camera and a file from stated ranges; `film` renders it. The pictures come from
rays (`ray_traced_die`) and share no code with the tracker's model of a picture or with the renderer of `diethrow film`.
"""

from .draw import Draw as Draw
from .draw import draw_clip as draw_clip
from .film import RENDERER_VERSION as RENDERER_VERSION
from .film import write_random_clip as write_random_clip
