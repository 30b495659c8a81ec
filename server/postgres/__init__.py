"""The embedded PostgreSQL: its programs, data directory and process."""
