"""Teams: their names, contacts and merging."""
