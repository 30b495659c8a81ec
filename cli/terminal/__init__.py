"""Output in a terminal: tables, JSON, the program's own name."""
