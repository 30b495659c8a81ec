"""`vitac serve` and `vitac worker`: processes of the service."""
