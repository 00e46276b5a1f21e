"""Simulation results: the result classes, error metrics, tracking assessment, plots and the 3D viewer."""
