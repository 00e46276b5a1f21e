"""Surfaces over a chart: polynomial and spline patches, fitted to meshes."""
