"""Rigid parts as affine bodies, and the stiff energy that keeps them rigid."""
