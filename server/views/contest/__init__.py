"""What is shown of the competition."""
