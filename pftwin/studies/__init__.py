"""Studies of scenes: cost of accuracy, influence of each effect, hard cases, contact at given poses."""
