"""One change at a time, and none half done: what a mapper that was interrupted says."""

from __future__ import annotations

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
    reported by `check` and the next `change`.
    """

    def __init__(self) -> None:
        # One entry at most, as `setdefault` is atomic; a list, for it is recognised by identity.
        self._holder: dict[str, list[int]] = {}

    def check(self) -> None:
        """Make sure that what is guarded is whole; in a change its own thread may look at it.

        Raises
        ------
        RelmapError
            Where another thread changes it, or a change was cut off.
        """
        holder = self._holder.get("thread")
        if holder is not None and holder[0] != get_ident():
            raise RelmapError(HALF_DONE if holder[0] == NOBODY else BUSY)

    def change(self, spoils: bool = True) -> Change:
        """Return what encloses a change, for `with`; a `RelmapError` means that it did not begin.

        Parameters
        ----------
        spoils : bool
            Whether any other exception leaves something half done.

        Raises
        ------
        RelmapError
            On entering, where a change is going on, or was cut off.
        """
        return Change(self._holder, spoils)


class Change:
    """A change that goes on between entering and leaving; see `ChangeGuard.change`."""

    __slots__ = ("_holder", "_mine", "_spoils")

    def __init__(self, holder: dict[str, list[int]], spoils: bool) -> None:
        self._holder, self._spoils, self._mine = holder, spoils, [get_ident()]

    def __enter__(self) -> None:
        holder = self._holder.setdefault("thread", self._mine)
        if holder is not self._mine:
            raise RelmapError(HALF_DONE if holder[0] in (NOBODY, self._mine[0]) else BUSY)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or not self._spoils or issubclass(kind, RelmapError):
            self._holder.clear()
        else:
            self._mine[0] = NOBODY
