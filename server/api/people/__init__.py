"""Routes of the people around a competition: members of teams and what they say to each other."""
