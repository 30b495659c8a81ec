"""What pages show as files, to be read by programs."""
