"""Evaluations: their life from the first shard to the score."""
