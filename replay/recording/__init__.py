"""replay.recording."""

from .several_throws import Source as Source
from .several_throws import join_recordings as join_recordings
from .several_throws import properties_of as properties_of
from .throw_recording import write_recording as write_recording
from .throw_recording import write_throw_recording as write_throw_recording
