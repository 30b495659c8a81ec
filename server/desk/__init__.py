"""What an organizer has to look at."""
