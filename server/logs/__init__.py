"""Uploaded logs: what they claim, how models compare with them, and their export."""
