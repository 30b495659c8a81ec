"""Nouns of `vitac admin` about notices, announcements, questions and appeals."""
