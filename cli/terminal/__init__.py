"""Terminal output: tables, JSON, and the name of the program."""
