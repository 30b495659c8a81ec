"""A task of somebody else's: lift a block off a table."""
