"""Find by touch which of six ends a held block has; the answer is scored."""
