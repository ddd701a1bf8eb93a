"""What each stage and rule of the diagnosis buys: see README.md."""
