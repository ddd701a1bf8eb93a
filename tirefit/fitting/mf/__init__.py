"""A whole Magic Formula from measured rows: stages, priors, guards, uncertainty."""
