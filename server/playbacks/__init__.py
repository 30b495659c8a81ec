"""Playbacks of episodes: who may ask for how many, the work on them, and their files."""
