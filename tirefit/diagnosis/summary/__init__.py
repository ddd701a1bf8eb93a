"""Closure, budget, forecast, next measurement, and the document of a diagnosis."""
