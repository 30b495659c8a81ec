"""What a result is shared with: a picture beside its link, and texts that cite it."""
