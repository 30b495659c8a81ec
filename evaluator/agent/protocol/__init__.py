"""What the evaluator and a policy say to each other: frames, channel, and what counts as an action."""
