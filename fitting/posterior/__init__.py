"""Samples the posterior of an estimate's parameters."""
