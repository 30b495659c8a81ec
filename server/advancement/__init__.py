"""Who advances to a stage."""
