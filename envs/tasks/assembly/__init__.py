"""A part is fetched from a tray, put into a socket and turned until it locks: scene, task and `ViTac/Assembly-v1`."""
