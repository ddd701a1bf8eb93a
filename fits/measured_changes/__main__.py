"""Runs the command of :mod:`fits.measured_changes.run`."""

from fits.measured_changes.run import main

if __name__ == "__main__":
    main()
