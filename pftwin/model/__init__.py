"""What is simulated: a scene of bodies, motion and effects. Knows no solver."""
