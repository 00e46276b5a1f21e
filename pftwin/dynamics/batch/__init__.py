"""Simulation of many variants in one batch, distributed over all devices."""
