"""Competitions: their definition, stages, own tracks and sealed lists."""
