"""The `vitac` command line: one module per noun; nothing imports it."""
