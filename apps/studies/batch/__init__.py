"""Trials of runs over many shapes."""
