"""Figures of a sensor: what it can measure, how it is gripped, and how much its score depends on the simulation."""
