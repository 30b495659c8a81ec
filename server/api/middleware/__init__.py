"""What every request passes before its route: limits of head and body, and the time that it took."""
