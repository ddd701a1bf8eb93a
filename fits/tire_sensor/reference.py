"""Independent numbers: ``python -m fits.tire_sensor.reference``.

S section 3.6 as printed, in NumPy, at points of the Gough plot, and its inverse by a
root of the trail with SciPy.
"""

from scipy.optimize import brentq


def force_and_moment(theta, mu):
    """F_y/F_z and -M_z/(a F_z) of S section 3.6."""
    y = theta / mu**2 * (3 * mu**2 - 3 * mu * theta + theta**2)
    return y, theta / mu**3 * (mu - theta) ** 3


def inverse(y, m):
    """theta and used friction: the trail m / y depends on theta / mu alone."""

    def gap(share):
        force, moment = force_and_moment(share, 1.0)
        return moment / force - m / y

    share = brentq(gap, 1e-9, 1.0)
    used = force_and_moment(share, 1.0)[0]
    return share * y / used, used


def reference() -> dict[str, float]:
    """Used friction of three points."""
    points = {"A": (0.1, 0.5), "B": (0.3, 0.5), "C": (0.5, 1.0)}
    return {
        f"used at {name}": float(inverse(*force_and_moment(theta, mu))[1])
        for name, (theta, mu) in points.items()
    }


if __name__ == "__main__":
    for name, value in reference().items():
        print(f"{name:12s} {value:.7g}")
