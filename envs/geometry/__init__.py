"""Rigid parts of the tasks, generated from the challenge's dimension tables."""
