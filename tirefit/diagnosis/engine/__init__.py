"""The inference of a diagnosis, the same for rows of a tire, of a simulator, and windows
of a car: search, posterior, data left out, sizes by group, decision. All of it reads fits
linearised and whitened (:class:`~tirefit.diagnosis.engine.fit.Fit`).

The constants are values that count as zero: guards of quotients, logarithms and comparisons, for
values that are whitened or relative, and so of order one."""

NONZERO = 1e-300
"""Divisor that replaces zero, so that 0/0 gives 0; its reciprocal is still finite."""

ROUNDING = 1e-12
"""Smaller values are rounding errors of 64-bit sums over ten thousand rows."""

FLAT = 1e-9
"""A range, slip, force or length of this size counts as zero: far above rounding, and a
hundredth of the resolution of a 24-bit sensor."""

UNSEEN = 1e-6
"""Smallest length of a direction of whitened rows: an effect of usual size then changes
all rows together by a millionth of a standard error, which no test can detect."""
