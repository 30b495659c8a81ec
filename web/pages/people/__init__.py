"""Pages of the people around a competition: teams, what they say to each other, the organizers' desk."""
