"""The challenge's own method (challenge-facts 8): networks, TD3 with Stable-Baselines3, and submissions made so."""
