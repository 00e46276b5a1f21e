"""Measures how often a posterior's intervals contain the true values of simulated knees that differ from the twin."""
