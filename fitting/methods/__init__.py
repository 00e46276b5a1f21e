"""Search methods of fits. Each asks for evaluations and receives their results."""
