"""Contact at recorded poses: pressure maps at every frame, without a simulation."""
