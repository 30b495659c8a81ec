"""Who takes part: teams, members, tokens, quotas, and what they are written."""
