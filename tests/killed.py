"""A process that dies at each step of its work on files."""

import os


def killed_at(step, work):
    """The exit status of a process that runs ``work`` and dies in place of a renaming or
    removal of a file: the one after ``step`` others."""
    process = os.fork()
    if process == 0:
        left = [step]

        def dying(of):
            def once(*arguments, **named):
                if not left[0]:
                    os._exit(9)
                left[0] -= 1
                return of(*arguments, **named)

            return once

        for name in ("replace", "unlink", "rename"):
            setattr(os, name, dying(getattr(os, name)))
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def steps_of(work, restore, most=60):
    """Runs ``work`` until it is not killed any more; yields after each kill."""
    for step in range(most):
        restore()
        if killed_at(step, work) == 0:
            return
        yield step
    raise AssertionError("it never ended")
