"""Announcements and questions."""
