"""Footage to poses and bounces."""
