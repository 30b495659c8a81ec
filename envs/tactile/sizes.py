"""How much a tactile sensor gives; apart from `markers`, so that tables can be made without the simulation."""

SENSING_NODES = 49
"""Nodes on the sensing face of the gel of the evaluations (`gel.gelsight_mini_mesh`)."""

MARKER_COUNT = 128
"""Markers in a marker flow; where fewer are seen the last is repeated."""
