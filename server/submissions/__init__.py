"""Submissions: accepted, read by their team, cancelled, run again."""
