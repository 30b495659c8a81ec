"""Who asks: teams, tokens and what they may see."""
