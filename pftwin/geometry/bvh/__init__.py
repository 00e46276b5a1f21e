"""Bounding volume hierarchies (BVH) of triangle meshes: built with NumPy on the host, searched in JAX."""
