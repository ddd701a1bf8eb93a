"""Simulations over time: tires, wheels, test rigs and cars."""
