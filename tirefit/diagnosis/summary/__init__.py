"""Room 6: closure, budget, forecast, next measurement, and the document."""
