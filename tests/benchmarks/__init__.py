"""How fast and how accurate: `python -m tests.benchmarks` measures the rows of docs/benchmarks.md on this machine."""
