"""Commands: one file per command, each a function that anyone can call; the command line in `cli` adds only options and output.

`clip` holds the commands on clips and tracks, `model` those that simulate, `results` those on folders of results. The functions
are imported from their files, so that a command loads only what it needs.
"""
