"""Boards of a track: models, and logs, by competition, stage and task."""
