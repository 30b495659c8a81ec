"""Newton's method on the forces of one IPC step."""
