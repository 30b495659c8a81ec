"""`vitac demo`: an evaluation on a service of its own."""
