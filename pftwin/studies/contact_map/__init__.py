"""Contact at recorded poses: pressure maps frame by frame, without a simulation."""
