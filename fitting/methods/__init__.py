"""Methods of fitting. Each asks for evaluations and receives their results."""
