"""A car on its tires: predict measured logs, fit tires to them, diagnose the car."""
