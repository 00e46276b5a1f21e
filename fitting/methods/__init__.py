"""Methods of fitting. Each asks for evaluations and is told their answers."""
