"""Runs a function in a separate process that is stopped before each call that changes files.

For Linux on x86-64.  A filter in the kernel picks the calls, so that others take no time.
"""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SPACE = {
    **{1: "write", 2: "open", 18: "pwrite64", 20: "writev", 40: "sendfile", 77: "ftruncate"},
    **{83: "mkdir", 85: "creat", 86: "link", 88: "symlink", 257: "openat", 258: "mkdirat"},
    **{265: "linkat", 266: "symlinkat", 285: "fallocate", 296: "pwritev"},
    **{326: "copy_file_range", 328: "pwritev2"},
}
OTHERS = {
    **{3: "close", 26: "msync", 74: "fsync", 75: "fdatasync", 76: "truncate", 82: "rename"},
    **{84: "rmdir", 87: "unlink", 90: "chmod", 91: "fchmod", 132: "utime", 235: "utimes"},
    **{263: "unlinkat", 264: "renameat", 268: "fchmodat", 280: "utimensat", 316: "renameat2"},
}
CALLS = SPACE | OTHERS
"""Names of the system calls by number; those of `SPACE` fail on a full disk."""
CLOSE = 3
BY_DESCRIPTOR = {1, CLOSE, 18, 20, 296, 328}
FIRST, SECOND, THIRD, NUMBER, RESULT = 14 * 8, 13 * 8, 12 * 8, 15 * 8, 10 * 8
"""Places of arguments, number and result of a call among the registers of a stopped process."""
OPENS = {2: SECOND, 257: THIRD}
"""Places of the flags of calls that open files."""
TRACEME, PEEK, POKE, CONTINUE, OPTIONS = 0, 3, 6, 7, 0x4200
FOLLOW_AND_KILL = 0x80 | 0x2 | 0x4 | 0x8 | 0x100000
AT_CALL = signal.SIGTRAP | 7 << 8
ALL = 0x40000000

libc = ctypes.CDLL(None, use_errno=True)
libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
libc.ptrace.restype = ctypes.c_long

AtCall = Callable[[int, str], int]
"""Is given number, from 1, and name of a call; returns the error to end it with, or 0."""


@dataclass(frozen=True)
class Traced:
    """Exit code, names of the calls, and standard error."""

    code: int
    calls: list[str]
    said: str


def traced(work: Callable[[], int], at_call: AtCall = lambda number, name: 0) -> Traced:
    """Run a function that returns an exit code, in a fork that is stopped at its calls."""
    sys.stdout.flush()
    said = os.memfd_create("stderr")
    child = os.fork()
    if child == 0:
        _stop_at_calls(said)
        code = 99
        try:
            code = work()
        finally:
            os._exit(code)
    if not os.WIFSTOPPED(os.waitpid(child, 0)[1]):
        raise SystemExit("processes may not be traced here")
    libc.ptrace(OPTIONS, child, None, FOLLOW_AND_KILL)
    calls: list[str] = []
    code = _followed(child, calls, at_call)
    with os.fdopen(said, "rb") as stream:
        stream.seek(0)
        return Traced(code, calls, stream.read().decode())


def _stop_at_calls(said: int) -> None:
    """Prepare a child: silence it, and have the kernel stop it at the calls."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(said, 2)
    rules = [struct.pack("HBBI", 0x20, 0, 0, 0)]  # load the number of the call
    for k, number in enumerate(CALLS):
        rules.append(struct.pack("HBBI", 0x15, len(CALLS) - k, 0, number))
    rules += [struct.pack("HBBI", 0x06, 0, 0, reply) for reply in (0x7FFF0000, 0x7FF00000)]
    program = ctypes.create_string_buffer(b"".join(rules))
    filters = struct.pack("HxxxxxxP", len(rules), ctypes.addressof(program))
    if libc.ptrace(TRACEME, 0, None, None):
        os._exit(98)
    os.kill(os.getpid(), signal.SIGSTOP)
    if libc.prctl(38, 1, 0, 0, 0) or libc.prctl(22, 2, ctypes.c_char_p(filters), 0, 0):
        os._exit(98)


def _followed(child: int, calls: list[str], at_call: AtCall) -> int:
    """Let a child and its threads and processes run to the end; return its exit code."""
    process, pass_on = child, 0
    while True:
        libc.ptrace(CONTINUE, process, None, pass_on)
        process, status = os.waitpid(-1, ALL)
        pass_on = 0
        if os.WIFSTOPPED(status):
            if status >> 8 == AT_CALL:
                _stopped(process, calls, at_call)
            elif os.WSTOPSIG(status) not in (signal.SIGTRAP, signal.SIGSTOP):
                pass_on = os.WSTOPSIG(status)
        elif process == child:
            return os.waitstatus_to_exitcode(status)


def _stopped(process: int, calls: list[str], at_call: AtCall) -> None:
    """Count a call if it changes files, and let it fail if that is wanted."""
    number = libc.ptrace(PEEK, process, NUMBER, None)
    if not _changes_files(process, number):
        return
    calls.append(CALLS[number])
    if error := at_call(len(calls), CALLS[number]):
        libc.ptrace(POKE, process, NUMBER, 2**64 - 1)  # no call at all
        libc.ptrace(POKE, process, RESULT, 2**64 - error)


def _changes_files(process: int, number: int) -> bool:
    first = libc.ptrace(PEEK, process, FIRST, None)
    if number in OPENS:
        flags = libc.ptrace(PEEK, process, OPENS[number], None)
        return bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
    if number in BY_DESCRIPTOR and first <= 2:
        return False
    return number != CLOSE or _is_open_for_writing(process, first)


def _is_open_for_writing(process: int, descriptor: int) -> bool:
    try:
        info = Path(f"/proc/{process}/fdinfo/{descriptor}").read_text()
    except OSError:
        return False
    flags = int(info.split("flags:")[1].split()[0], 8)
    return bool(flags & 3) and Path(f"/proc/{process}/fd/{descriptor}").is_file()
