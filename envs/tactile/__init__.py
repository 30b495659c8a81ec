"""GelSight Mini sensor: gel meshes, camera, markers and what a policy sees of them."""
