"""Leaderboards: who is ranked where, which results everybody may see, and boards as they are read."""
