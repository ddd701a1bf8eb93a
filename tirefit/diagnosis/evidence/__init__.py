"""Room 3: forward model, search over sets of effects, discrepancy."""
