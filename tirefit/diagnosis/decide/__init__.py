"""Room 5: from evidence and left-out figures to a verdict."""
