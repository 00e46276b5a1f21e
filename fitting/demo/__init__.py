"""The demonstration: the virtual rig's cases beside measurements and the paper, its fit and its treatment."""
