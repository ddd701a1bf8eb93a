"""Fitted tires in the simulators and optimizers that people have."""
