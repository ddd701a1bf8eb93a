"""Tire property files."""
