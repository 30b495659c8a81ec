"""Commands of teams about people: the team itself, and what is said to the organizers."""
