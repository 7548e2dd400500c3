"""Replay: a Rerun recording, figures, and pages, drawn from records of a throw; and a camera's view of a simulated throw.

A `Record` holds what an analysis found. This package reads poses, bounces and parameters and draws them; it computes no
physics. Import names from the folders below: a figure then does not load the viewer.
"""
