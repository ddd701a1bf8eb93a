"""What counts as nothing: guards of quotients, logarithms and comparisons, in values
that are whitened or relative, and so of order one."""

NONZERO = 1e-300
"""Divisor in place of zero, where 0/0 counts as 0; its reciprocal is still finite."""

ROUNDING = 1e-12
"""Smaller values are what 64-bit sums over ten thousand rows leave of zero."""

FLAT = 1e-9
"""A range, slip, force or length of this size is none: far above rounding, and a
hundredth of what a sensor of 24 bits resolves."""

UNSEEN = 1e-6
"""Length of a direction of whitened rows of which an effect of the usual size changes
them all by a millionth of a standard error together: no test can see it."""

SILENT = 0.2
"""What is left over the noise, below which it is not looked at: digits that a formula
or a file left, or less than the noise was said to hide."""
