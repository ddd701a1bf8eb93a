"""Texts and figures of a diagnosis."""
