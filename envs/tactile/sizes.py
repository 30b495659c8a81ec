"""How much a tactile sensor gives; apart from `markers`, so that tables can be made without the simulation."""

MARKER_COUNT = 128
"""Markers in a marker flow; where fewer are seen the last is repeated."""
