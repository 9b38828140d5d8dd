"""Ctrl-C between chunks instead of in the middle of one."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """A function that raises KeyboardInterrupt if Ctrl-C was pressed since it was last called.

    While the block runs, Ctrl-C only sets a flag: CasADi's evaluator would swallow the exception
    or turn it into another one. The handler found is put back at the end. Handlers that somebody
    else has installed, and threads other than the main one, are left alone.
    """
    pressed = threading.Event()

    def remember(number: int, frame: FrameType | None) -> None:
        pressed.set()

    def check() -> None:
        if pressed.is_set():
            pressed.clear()
            raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield check
        return
    signal.signal(signal.SIGINT, remember)
    try:
        yield check
        check()  # pressed during the last chunk
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
