"""Studies of scenes: cost of accuracy, worth of effects, hard cases, contact at given poses."""
