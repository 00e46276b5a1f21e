"""Contact at recorded poses: what presses where, frame by frame, without simulating anything."""
