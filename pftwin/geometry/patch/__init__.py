"""Surfaces given as heights over a chart: polynomial and spline patches fitted to meshes, and a smooth implant."""
