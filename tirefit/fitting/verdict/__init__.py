"""What a fit is worth, and what its data determine."""
