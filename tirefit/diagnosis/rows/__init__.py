"""The rows as the diagnosis uses them, with their covariates and groups."""
