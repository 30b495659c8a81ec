"""`vitac submit` and `vitac status`: commands that talk to a service over HTTP."""
