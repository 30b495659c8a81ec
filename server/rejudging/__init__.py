"""Evaluations of a set of submissions beside their results, applied or discarded together."""
