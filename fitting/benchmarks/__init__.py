"""How fast and how right fits are: `python -m fitting.benchmarks` measures it; see docs/fitting_benchmarks.md."""
