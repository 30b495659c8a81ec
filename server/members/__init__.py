"""Members of teams, their passwords, and registration."""
