"""What is read from disk and written to it: motion capture, scene files, results, other programs."""
