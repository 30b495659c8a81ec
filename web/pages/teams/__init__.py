"""Pages of teams: registration, sign-in, members."""
