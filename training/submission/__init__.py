"""The policy of a trained submission, which training imports too."""
