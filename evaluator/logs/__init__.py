"""Evaluation logs: written, read, checked, verified by re-simulation, compared."""
