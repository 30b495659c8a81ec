"""What a team uploads: archive, submission manifest and digest."""
