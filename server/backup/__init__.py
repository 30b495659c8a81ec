"""Backups: the whole database and every uploaded file in one archive, and the way back."""
