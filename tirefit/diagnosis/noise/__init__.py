"""Room 2: the noise of every force and of the slip."""
