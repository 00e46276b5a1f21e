"""Triangle meshes: read, checked, repaired and made."""
