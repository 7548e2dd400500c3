"""Records to a Rerun recording, figures and a report.

A `Record` holds what an analysis found. Nothing here computes physics: poses, bounces and parameters are read and
drawn. The names are imported from their modules, because a figure should not have to load the viewer.
"""
