"""Nouns of `vitac admin` that run a competition."""
