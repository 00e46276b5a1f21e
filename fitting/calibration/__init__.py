"""Do a posterior's intervals hold the truth on knees that differ from the twin? `calibrate` makes such and counts."""
