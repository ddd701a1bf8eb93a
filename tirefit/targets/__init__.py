"""Export fitted tires to other simulators and optimizers."""
