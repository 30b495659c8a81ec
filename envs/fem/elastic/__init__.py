"""Elastic energy of the gels: the material of one tetrahedron, and its sum over all."""
