"""Commands on existing results: view and join recordings, repeat a run, compare folders.

Each module has a function that anyone can call; the command line adds options. Import from the modules: comparing folders
then does not load the viewer. `viewer` starts the Rerun viewer without access to a network.
"""
