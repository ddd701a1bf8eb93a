"""A fit as a problem: data, model and settings, with their noise."""
