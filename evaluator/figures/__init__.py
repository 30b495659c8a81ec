"""Figures of a sensor: what it can tell, how it is gripped, and how much its score depends on the simulation."""
