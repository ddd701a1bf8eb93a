"""Forward model, search over sets of effects, posterior with a discrepancy."""
