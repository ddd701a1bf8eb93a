"""Intervals, samples and bands."""
