"""Who this user is on a service: `vitac register`, `login`, `logout` and `whoami`."""
