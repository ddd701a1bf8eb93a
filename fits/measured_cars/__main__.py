"""Runs the command of :mod:`fits.measured_cars.run`."""

from fits.measured_cars.run import main

if __name__ == "__main__":
    main()
