"""How fast and how right fits are: `python -m tests.benchmarks.fitting` measures it; see docs/fitting_benchmarks.md."""
