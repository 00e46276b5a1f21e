"""Geometry of the articulating surfaces."""
