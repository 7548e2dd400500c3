"""Footage to a measured throw: poses of the die on every frame, its flights and impacts.

`footage` reads clips, `calibration` the camera. `picture`, `pose` and `sequence` find the die on every frame, with what a whole
clip shares (`clip_parameters`) and the marks on its faces (`surface_marks`). `throw` estimates flights and impacts, and `check`
judges clip and track. `camera`, `track` and `quality` are the values that pass between them.
"""
