"""Controllers of the brakes: ABS, and XBS of the sources."""
