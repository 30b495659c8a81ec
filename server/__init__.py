"""State and HTTP: database, queue, storage, competition rules, REST API."""
