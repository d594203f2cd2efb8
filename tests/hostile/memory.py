"""Peak memory of a block of code in this process."""

from __future__ import annotations

import gc
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def _kilobytes(name: str) -> int:
    found = re.search(rf"{name}:\s+(\d+) kB", STATUS.read_text())
    assert found, name
    return int(found[1])


@contextmanager
def at_most_mb(limit: float) -> Iterator[None]:
    """Assert that the resident memory grows by at most `limit` [MB] at any time during the block."""
    gc.collect()  # garbage of earlier tests, freed during the block, would hide what the block takes
    gc.freeze()  # not to search again what is left
    CLEAR.write_text("5")  # the peak restarts at the present value
    before = _kilobytes("VmRSS")
    yield
    assert (_kilobytes("VmHWM") - before) / 1000 <= limit
