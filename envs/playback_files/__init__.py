"""Episodes as small files that a page plays: what moves, and what the cameras saw. `evaluator.playback` writes them."""
