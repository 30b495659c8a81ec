"""Announcements of organizers, questions of teams and their answers."""
