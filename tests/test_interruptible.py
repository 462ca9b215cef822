"""Ctrl-C is not lost where Python or the compiler would swallow the exception."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import llvmlite.binding as llvm
import pytest

from relmap.cli.interrupt import interruptible
from tests.commands import PATIENCE_S, RELMAP, names

LONG_S = 60.0


class Pressed:
    """Ctrl-C is pressed while it is deleted."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def pressed_while_deleted() -> None:
    Pressed()


def pressed_while_forgotten() -> None:
    value = {1}
    kept = weakref.ref(value, lambda _: signal.raise_signal(signal.SIGINT))
    del value
    assert kept() is None


def pressed_while_compiled() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    module = llvm.parse_assembly("define i32 @one() { ret i32 1 }")
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.set_object_cache(lambda *_: signal.raise_signal(signal.SIGINT), lambda _: None)
    engine.finalize_object()
    assert engine.get_function_address("one")


def wait_after(press: Callable[[], None]) -> None:
    with interruptible():
        press()
        time.sleep(LONG_S)


@pytest.mark.parametrize(
    "press", [pressed_while_deleted, pressed_while_forgotten, pressed_while_compiled]
)
def test_ctrl_c_is_raised_after_the_function_that_would_swallow_it(
    press: Callable[[], None],
) -> None:
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        wait_after(press)
    assert time.monotonic() - began < LONG_S
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_sigterm_leaves_nothing_behind(tmp_path: Path, child_env: dict[str, str]) -> None:
    command = [*RELMAP, "figures", "12", "-o", "out"]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, env=child_env, cwd=tmp_path)
    while not ((tmp_path / "out").is_dir() and names(tmp_path / "out")):
        assert child.poll() is None
        time.sleep(0.01)
    child.terminate()
    errors = child.communicate(timeout=PATIENCE_S)[1]
    assert child.returncode == 130
    assert errors == b"relmap: interrupted\n"
    assert names(tmp_path) == []


def test_ctrl_c_while_a_string_is_executed_gives_the_same_status(
    tmp_path: Path, child_env: dict[str, str]
) -> None:
    program = """
import runpy
from relmap.cli import program
def interrupted(_):
    try:
        exec("raise KeyboardInterrupt")
    except KeyboardInterrupt:
        return 130
program.run = interrupted
runpy.run_module("relmap", run_name="__main__")
"""
    (tmp_path / "pressed.py").write_text(program)
    command = [sys.executable, "-m", "pressed"]
    assert subprocess.run(command, env=child_env, cwd=tmp_path).returncode == 130


def test_ctrl_c_that_is_handled_already_is_not_changed() -> None:
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        with interruptible():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert pressed == [signal.SIGINT]
