"""Peak memory of a piece of work, as reported by the operating system."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

_STATUS = Path("/proc/self/status")
_RESET = Path("/proc/self/clear_refs")
KB_PER_MB = 1024


class PeakMemory:
    """Measures this process from construction on; Linux only."""

    def __init__(self) -> None:
        # If the peak cannot be reset, it is that of the whole process so far.
        with suppress(OSError):
            _RESET.write_text("5")
        self._before = _kibibytes("VmRSS")

    @property
    def grown_mb(self) -> float | None:
        """Peak minus initial memory, megabytes; None if the system does not report it."""
        peak = _kibibytes("VmHWM")
        if peak is None or self._before is None:
            return None
        return max(peak - self._before, 0) / KB_PER_MB


def _kibibytes(name: str) -> int | None:
    """Return a line of the process status, kilobytes."""
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return None
    found = [line.split()[1] for line in lines if line.startswith(f"{name}:")]
    return int(found[0]) if found else None
