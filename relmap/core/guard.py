"""One change at a time, and none half done: what a mapper that was interrupted says."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import get_ident

from relmap.core.errors import RelmapError

HALF_DONE = (
    "an update of this mapper was interrupted half way, so what it holds is not whole: "
    "go on with resume from its journal or load from a saved state, or map again"
)
BUSY = "another thread is in the middle of an update of this mapper: give each thread its own"
NOBODY = -1
"""Stands for the thread that left a change half done; no thread has this number."""


class ChangeGuard:
    """Lets one thread at a time change something, and refuses it once a change was cut off.

    Whatever stops a change at whatever moment, Ctrl-C above all, either leaves no trace or is
    told by `check` and the next `change`.
    """

    def __init__(self) -> None:
        # One entry at most, as `setdefault` is atomic; a list, for it is told by identity.
        self._holder: dict[str, list[int]] = {}

    def check(self) -> None:
        """Make sure that what is guarded is whole; in a change its own thread may look at it.

        Raises
        ------
        RelmapError
            Where another thread changes it, or a change was cut off.
        """
        for (thread,) in self._holder.copy().values():
            if thread != get_ident():
                raise RelmapError(HALF_DONE if thread == NOBODY else BUSY)

    @contextmanager
    def change(self, spoils: bool = True) -> Iterator[None]:
        """Enclose a change; a `RelmapError` means that it did not begin.

        Parameters
        ----------
        spoils : bool
            Whether any other exception leaves something half done.

        Raises
        ------
        RelmapError
            Where a change is going on, or was cut off.
        """
        mine = [get_ident()]
        holder = self._holder.setdefault("thread", mine)
        if holder is not mine:
            raise RelmapError(HALF_DONE if holder[0] in (NOBODY, get_ident()) else BUSY)
        try:
            yield
        except RelmapError:
            self._holder.clear()
            raise
        except BaseException:
            if spoils:
                mine[0] = NOBODY
            else:
                self._holder.clear()
            raise
        self._holder.clear()
