"""Contribution of each stage and rule of the diagnosis; see fits/withheld/README.md."""
