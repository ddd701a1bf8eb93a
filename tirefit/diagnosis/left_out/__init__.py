"""Room 4: what each set predicts of data left out."""
