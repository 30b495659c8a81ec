"""`vitac show`: draws an episode."""
