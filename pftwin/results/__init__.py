"""What a simulation gives back, and what is computed and drawn from it."""
