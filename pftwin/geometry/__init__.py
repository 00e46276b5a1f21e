"""Geometry of the articulating surfaces: meshes, their trees, fitted patches, contact, wrapping and synthetic bones."""
