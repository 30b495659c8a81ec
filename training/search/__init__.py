"""Searches the few numbers of a small policy by what its episodes come to; for a task that needs no more."""
