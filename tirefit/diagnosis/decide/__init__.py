"""Decide a verdict from the evidence and from predictions of data left out."""
