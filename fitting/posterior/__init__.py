"""The posterior of an estimate's parameters, sampled."""
