"""Pages by which a team takes part: registering, signing in, uploading, and what its submissions show it alone."""
