"""Judging: marks by rubric, conflicts of interest, totals."""
