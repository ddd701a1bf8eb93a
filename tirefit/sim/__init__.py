"""Simulation: tires, and what they carry, in time."""
