"""Episodes on pages: all of a task as a map, and each on a page of its own."""
