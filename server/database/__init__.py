"""The database: embedded server, engine, models, schema upgrades, and what processes count."""
