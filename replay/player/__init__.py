"""A throw that plays in a page: the die in 3D at its poses, and its outline on the camera's picture beside it.

A small canvas drawn by a script of the page; no library and no network. `player_html` writes it, with the data; the script and
the style sheet stand beside it as files of their own.
"""

from .player_html import player_alone as player_alone
from .player_html import player_html as player_html
from .player_html import player_policy as player_policy
from .player_html import player_script as player_script
from .player_html import player_style as player_style
