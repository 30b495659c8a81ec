"""Clones an expert that knows the truth into a policy that does not, for any task that has an expert."""
