"""What a scene is made of: meshes, bodies, settings, and the arrays that kernels read."""
