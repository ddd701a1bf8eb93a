"""What each stage and rule of the diagnosis buys; see fits/withheld/README.md."""
