"""The documentation: `docs/` as pages of the arena, with the reference that the code itself writes, and a search."""
