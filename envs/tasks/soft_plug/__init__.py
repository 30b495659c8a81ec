"""Pushing an elastic plug, or the connector at a cable's end, into a hole without bending or crushing what is held."""
