"""How many processor cores there are to work with."""

import os


def count() -> int:
    """Cores that this process may use: in a container, or under taskset, fewer than there are."""
    if hasattr(os, "sched_getaffinity"):  # Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
