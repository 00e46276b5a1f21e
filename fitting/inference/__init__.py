"""Posteriors learned from simulated recordings: what parameters, of all those that could be, leave such a recording?"""
