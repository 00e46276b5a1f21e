"""Demonstrations: the virtual rig's cases compared with measurements and the paper, a fit and a treatment."""
