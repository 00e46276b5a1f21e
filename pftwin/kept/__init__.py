"""Compiled programs and what was derived from files, kept from one process to the next; off until a folder is given."""
