"""The linear system of a Newton iteration: its pattern, the order of elimination, and its factors."""
