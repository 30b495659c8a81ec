"""Incremental potential contact: candidate pairs, distances, barrier, mollifier, friction, and their sum."""
