"""Least squares, and what it knows of its rows."""
