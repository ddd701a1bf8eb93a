"""Texts and figures of a fit."""
