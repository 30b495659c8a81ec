"""Estimates what a station is like from moves that touch plate and hole, and from nothing else."""
