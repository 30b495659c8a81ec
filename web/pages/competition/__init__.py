"""The front page, and pages of the competition."""
