"""The state of the service for its operators: desk, metrics, backups, housekeeping, a team's data."""
