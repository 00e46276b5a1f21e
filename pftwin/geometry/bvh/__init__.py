"""Bounding volume hierarchies of triangle meshes: built on the host, searched in JAX."""
