"""Poses to the restitution coefficient and the initial conditions."""
