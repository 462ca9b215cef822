"""Detection of concurrent and interrupted updates of a mapper."""

from __future__ import annotations

from threading import get_ident

from relmap.core.errors import RelmapError

HALF_DONE = (
    "an update of this mapper was interrupted, so its state is incomplete: "
    "resume from its journal, load a saved state, or map again"
)
BUSY = "another thread is updating this mapper: use one mapper per thread"
NOBODY = -1
"""Marks a change left incomplete by some thread; no thread has this number."""


class ChangeGuard:
    """Allows one thread at a time to change an object, and refuses changes after an incomplete one.

    A change interrupted at any moment, for example by Ctrl-C, either has no effect or is reported
    by `check` and the next `change`.
    """

    def __init__(self) -> None:
        # At most one entry, as `setdefault` is atomic; a list, because it is compared by identity.
        self._holder: dict[str, list[int]] = {}

    def check(self) -> None:
        """Check that the guarded object is complete; during a change its own thread may read it.

        Raises
        ------
        RelmapError
            If another thread is changing it, or a change was interrupted.
        """
        holder = self._holder.get("thread")
        if holder is not None and holder[0] != get_ident():
            raise RelmapError(HALF_DONE if holder[0] == NOBODY else BUSY)

    def change(self, spoils: bool = True) -> Change:
        """Return a context manager for a change; on `RelmapError` the change did not begin.

        Parameters
        ----------
        spoils : bool
            Whether any other exception leaves the object incomplete.

        Raises
        ------
        RelmapError
            On entry, if a change is in progress or was interrupted.
        """
        return Change(self._holder, spoils)


class Change:
    """A change in progress; see `ChangeGuard.change`."""

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
