"""Readers of file formats: each gives a table of cells."""
