"""The competition: its file, its stages, and their sealed lists."""
