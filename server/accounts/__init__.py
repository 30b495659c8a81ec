"""Who asks: teams, tokens, principals and the audit log."""
