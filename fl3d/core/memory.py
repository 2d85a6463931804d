"""How this process holds memory."""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD = -1, -2, -3  # of glibc's malloc.h
LARGEST = 32 << 20  # the highest threshold that glibc takes
KEPT = (1 << 31) - 1


def keep_freed_memory() -> None:
    """Let the C library keep what is freed for what comes next, where it can.

    A training step frees and asks for the same buffers as the one before. By default glibc returns those of some
    megabytes to the kernel, which hands them out again a page at a time, each filled with zeros: 3000 to 7000 page
    faults a step of profile quick.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST)
        mallopt(M_TRIM_THRESHOLD, KEPT)
