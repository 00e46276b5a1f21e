"""How fast and how accurate: `python -m pftwin.benchmarks` measures the rows of docs/benchmarks.md on this machine."""
