"""A whole car on its tires: prediction of a measured log from measured states."""
