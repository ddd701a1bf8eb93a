"""A process that is killed at each step of its work on files."""

import os
from unittest.mock import patch


class Killed(BaseException):
    """Ends the work, as a kill does."""


def killed_at(step, work):
    """Whether ``work`` was killed in place of a step: to rename or remove a file or to make
    a folder, after ``step`` others. Once dead, it changes no file more, not even in
    ``finally``."""
    left = [step]

    def dying(of):
        def once(*arguments, **named):
            left[0] -= 1
            if left[0] < 0:
                raise Killed
            return of(*arguments, **named)

        return once

    names = ("mkdir", "replace", "rename", "unlink", "remove", "rmdir")
    try:
        with patch.multiple(os, **{name: dying(getattr(os, name)) for name in names}):
            work()
    except Killed:
        return True
    return False


def steps_of(work, restore, most=60):
    """Runs ``work`` until it is not killed any more; yields after each kill."""
    for step in range(most):
        restore()
        if not killed_at(step, work):
            return
        yield step
    raise AssertionError("it never ended")
