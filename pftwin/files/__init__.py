"""File formats: motion capture, scene files, results, and exchange with other programs."""
