"""A whole evaluation on this machine, and its report."""
