"""The command line: `main` is the program `diethrow`.

`app` holds the program itself, `options` what commands share, `errors` how a failure becomes one sentence and an exit
status; `clip_commands`, `model_commands` and `result_commands` define one function a command; `printing` and `progress`
write what a command reports, `compiling` announces the first compilation and shares it with other processes. Every command
imports what it needs when it runs.
"""

from . import clip_commands as clip_commands
from . import model_commands as model_commands
from . import result_commands as result_commands
from .app import app as app
from .app import main as main
