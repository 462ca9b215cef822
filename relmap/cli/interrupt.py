"""Ctrl-C that ends a loop gracefully, or a command at once, as SIGTERM does."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any

CALLED_FROM_C = ("llvmlite.", "numba.core.serialize", "numba.core.types.abstract")
"""Modules of the compiler whose functions are called back from C, where an exception is lost."""
DELETING = ("__del__", "cb", "_send_lost")
"""Functions called when an object is deleted, where an exception is lost; `cb` is the import's."""
UNHANDLED = (signal.default_int_handler, signal.SIG_DFL)
AGAIN_S = 0.01
"""Time after which an interrupt that would be lost is sent again."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C and SIGTERM, also while compiled code is made or loaded.

    Python's own handler may raise it in a function that C code calls: there it is printed and
    forgotten. Outside the main thread nothing is changed, nor is a signal that is handled already.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    main = threading.current_thread() is threading.main_thread()
    changed = [number for number in before if main and before[number] in UNHANDLED]
    printed = sys.unraisablehook
    for number in changed:
        signal.signal(number, _raise_where_heard)
    if changed:
        sys.unraisablehook = partial(_send_lost, printed)
    try:
        yield
    finally:
        for number in changed:
            signal.signal(number, before[number])
        sys.unraisablehook = printed


def _raise_where_heard(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, or send the signal again soon if the exception would be lost."""
    if not _is_lost(frame):
        raise KeyboardInterrupt(number)
    threading.Timer(AGAIN_S, _send_again, (number,)).start()


def _send_lost(printed: Callable[[Any], object], unraisable: Any) -> None:
    """Send a signal again whose exception is lost, as in callbacks of weak references."""
    lost = unraisable.exc_value
    if isinstance(lost, KeyboardInterrupt) and lost.args:
        threading.Timer(AGAIN_S, _send_again, lost.args).start()
    else:
        printed(unraisable)


def _send_again(number: int) -> None:
    """Send a signal to the main thread, which may wait for something meanwhile."""
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, number)
    else:  # Windows
        signal.raise_signal(number)


def _is_lost(frame: FrameType | None) -> bool:
    """Return whether an exception raised in this frame may be swallowed by the code around it."""
    while frame is not None:
        module = str(frame.f_globals.get("__name__", ""))
        if module.startswith(CALLED_FROM_C) or frame.f_code.co_name in DELETING:
            return True
        frame = frame.f_back
    return False


@contextmanager
def stoppable() -> Iterator[Callable[[], bool]]:
    """Provide a function that returns whether Ctrl-C was pressed; a second Ctrl-C interrupts.

    Outside the main thread, or if signals are ignored, Ctrl-C is not changed.
    """
    asked = threading.Event()
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not main or before in (signal.SIG_IGN, None):
        yield asked.is_set
        return

    def stop(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        asked.set()

    signal.signal(signal.SIGINT, stop)
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGINT, before)
