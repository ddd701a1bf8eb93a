"""What in a derived log is hardly the tire's."""

__all__ = ["doubts"]


def doubts(columns, motion, kept, vehicle) -> tuple[str, ...]:
    return ()
