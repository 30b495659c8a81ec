"""The challenge's own method: networks, TD3 with Stable-Baselines3, and submissions made so."""
