"""Sensors that teams design (Track 3): package, limits, checks and the mesh that is scored."""
