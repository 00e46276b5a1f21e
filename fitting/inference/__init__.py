"""Posteriors learned from simulated recordings: which parameters, of all possible ones, produce such a recording."""
