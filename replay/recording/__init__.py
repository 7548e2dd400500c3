"""Rerun recordings: one of a throw, with experiment and model on the same timelines, or one that joins several recordings.

`write_recording` draws a `Record`, `write_throw_recording` a simulated throw, `join_recordings` several recordings;
`properties_of` reads the summary that a recording contains. The commands that analyse, simulate and replay use these.
"""

from .several_throws import Source as Source
from .several_throws import join_recordings as join_recordings
from .several_throws import properties_of as properties_of
from .throw_recording import write_recording as write_recording
from .throw_recording import write_throw_recording as write_throw_recording
