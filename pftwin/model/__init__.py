"""The model: a scene of bodies, motion and effects, independent of solvers."""
