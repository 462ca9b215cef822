"""Detection of concurrent and interrupted updates of a mapper."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import isfunction
from threading import get_ident
from typing import Any, TypeVar

from relmap.core.errors import RelmapError

T = TypeVar("T")

HALF_DONE = (
    "an update of this mapper was interrupted, so its state is incomplete: "
    "resume from its journal, load a saved state, or map again"
)
BUSY = "another thread is updating this mapper: use one mapper per thread"
NO_THREAD = -1
"""Marks a change that was left incomplete; no thread has this number."""


class ChangeGuard:
    """Allows one thread at a time to change an object, and refuses changes after an incomplete one.

    A change interrupted at any moment, for example by Ctrl-C, either has no effect or is reported
    by `check` and the next `change`.

    `latest`: identifies the latest change that was begun: another object for each.
    """

    def __init__(self) -> None:
        self.latest: list[int] = []
        # At most one entry, as `setdefault` is atomic; a list, because it is compared by identity.
        self._holder: dict[str, list[int]] = {}

    def check(self) -> None:
        """Check that the guarded object is complete; during a change its own thread may read it.

        Raises `RelmapError` if another thread is changing it, or a change was interrupted.
        """
        holder = self._holder.get("thread")
        if holder is not None and holder[0] != get_ident():
            raise RelmapError(HALF_DONE if holder[0] == NO_THREAD else BUSY)

    def change(self, spoils: bool = True) -> Change:
        """Return a context manager for a change; on `RelmapError` the change did not begin.

        `spoils`: whether any other exception leaves the object incomplete. Raises `RelmapError` on
        entry, if a change is in progress or was interrupted.
        """
        return Change(self, self._holder, spoils)

    @property
    def is_changing(self) -> bool:
        """Whether a change is in progress, or was interrupted."""
        return bool(self._holder)

    def check_same(self, latest: list[int]) -> None:
        """Check that no change began since `latest` was read.

        Raises `RelmapError` if one did: the data read since then may be of two states.
        """
        if self.latest is not latest:
            raise RelmapError(BUSY)


class Change:
    """A change in progress; see `ChangeGuard.change`."""

    __slots__ = ("_guard", "_holder", "_mine", "_spoils")

    def __init__(self, guard: ChangeGuard, holder: dict[str, list[int]], spoils: bool) -> None:
        self._guard, self._holder, self._spoils = guard, holder, spoils
        self._mine = [get_ident()]

    def __enter__(self) -> None:
        holder = self._holder.setdefault("thread", self._mine)
        if holder is not self._mine:
            raise RelmapError(HALF_DONE if holder[0] in (NO_THREAD, self._mine[0]) else BUSY)
        if self._spoils:
            self._guard.latest = self._mine

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or not self._spoils or issubclass(kind, RelmapError):
            self._holder.clear()
        else:
            self._mine[0] = NO_THREAD


def reads_whole(*changing: str) -> Callable[[type[T]], type[T]]:
    """Return a class decorator: what another thread changes during a call is not returned.

    It applies to the public methods and properties that a class defines, and its `_guard`.

    `*changing`: methods that change the object themselves.
    """

    def decorated(cls: type[T]) -> type[T]:
        for name, member in list(vars(cls).items()):
            if name in changing or (name.startswith("_") and name != "__repr__"):
                continue
            if isinstance(member, property):
                setattr(cls, name, property(_whole(member.fget), doc=member.__doc__))
            elif isfunction(member):
                setattr(cls, name, _whole(member))
        return cls

    return decorated


def _whole(read: Any) -> Any:
    """Return a method that fails if a change begins while it runs."""

    @wraps(read)
    def checked(self: Any, *given: Any, **named: Any) -> Any:
        guard, latest = self._guard, self._guard.latest
        try:
            found = read(self, *given, **named)
        except Exception:
            guard.check_same(latest)
            raise
        guard.check_same(latest)
        return found

    return checked
