"""What organizers and teams say to each other, appeals, and what a team may have of its own data."""
