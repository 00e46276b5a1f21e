"""Ours and others' methods of fitting on one problem, on equal evaluations and on equal time."""
