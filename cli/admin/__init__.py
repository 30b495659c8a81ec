"""`vitac admin`: the organizer's commands."""
