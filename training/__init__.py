"""Trains policies from nothing but the environments: a critic that sees the truth, and a student that feels it."""
