"""Room 1: the rows as the diagnosis takes them, their covariates and groups."""
