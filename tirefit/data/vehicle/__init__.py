"""Logs of vehicles: their columns, checks, and the slip and force of an axle."""
