"""What a team hands in: archive, manifest and digest."""
