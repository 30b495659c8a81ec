"""The database: embedded server, engine, models and schema upgrades."""
