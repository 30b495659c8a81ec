"""Leaderboards of tracks and tasks, and the boards of logs."""
