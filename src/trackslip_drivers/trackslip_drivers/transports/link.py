# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The connect–read–back-off loop of every sensor, in a thread of its own.

Whatever goes wrong with a sensor ends here: the port is closed, the error is counted and kept as text for
diagnostics, and the port is opened again: at once where it was only silent, else after a pause. The process
goes on.
"""

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from trackslip_drivers.stamping import Look

T = TypeVar("T")

READ_TIMEOUT_S = 0.1  # longest wait of a port: how soon ``stop`` is noticed
FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 0.5  # a sensor that is back is read again within a second
_STOP_S = 0.4


class Port(Protocol[T]):
    """An open transport. Any exception from it means that it is to be closed and opened again."""

    note: str  # what differs from what was asked for; empty when nothing does

    def read(self) -> Iterable[tuple[T, int]]:
        """What has arrived, each with its arrival in ns of system time; empty after READ_TIMEOUT_S.

        It may go on for as long as more arrives.
        """

    def write(self, data: T) -> None:
        """Send, or raise."""

    def close(self) -> None:
        """Release the device; never called twice."""


@dataclass(frozen=True)
class LinkState:
    """A look at a link, for diagnostics."""

    connected: bool
    since_s: float  # for how long connected or disconnected
    openings: int  # times the port was opened; reconnections are one less
    errors: int
    last_error: str
    was_silent: bool  # it was closed because nothing came
    last_error_s: float  # system time of it, s since 1970; 0 where there was none
    note: str
    silent_s: float  # s since something was received, or the port was opened
    has_received: bool  # something has come since the driver was started


@dataclass(frozen=True)
class Handlers(Generic[T]):
    """What a link calls, in its own thread.

    on_data: with what arrived and its arrival in ns. on_open: after each opening, before any data, the moment
    to drop half-received messages and to start a dialogue. on_silence: after a read that found nothing for
    READ_TIMEOUT_S; only such a read proves that nothing is there: on a busy host, bytes wait in the kernel.
    """

    on_data: Callable[[T, int], None]
    on_open: Callable[[], None]
    on_silence: Callable[[], None] = lambda: None


class Link(Generic[T]):
    """Keeps one port open and passes on what it receives.

    Args:
        name: of the thread.
        open_port: opens the port, or raises.
        handlers: what to call.
        silence_s: a port that stays silent for longer is closed and opened again, as a line that hangs
            half-open reports no error; infinite to wait for ever.

    Attributes:
        look: how long what is handed on may have waited in the port; for the link's own thread.
    """

    def __init__(
        self,
        name: str,
        open_port: Callable[[], Port[T]],
        handlers: Handlers[T],
        silence_s: float = math.inf,
    ) -> None:
        self._open_port = open_port
        self._handlers = handlers
        self._silence_s = silence_s
        self.look = Look(time.monotonic_ns())
        self._lock = threading.Lock()  # guards what follows
        self._port: Port[T] | None = None
        self._changed_s = time.monotonic()
        self._openings = 0
        self._errors = 0
        self._last_error = ""
        self._was_silent = False
        self._last_error_s = 0.0
        self._received_s = time.monotonic()
        self._has_received = False
        self._note = ""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin connecting."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the port; returns within half a second even if an opening hangs."""
        self._stopping.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(_STOP_S)

    def write(self, data: T) -> bool:
        """Send, from any thread; False when there is no port or it refused."""
        return self.use(lambda port: port.write(data))

    def use(self, action: Callable[[Any], None]) -> bool:
        """Do something with the open port, from any thread; False when there is none or it failed.

        A failure is counted; a port that is truly gone fails in the loop as well, which then sees to it.
        """
        with self._lock:
            port = self._port
        if port is None:
            return False
        try:
            action(port)
        except Exception as error:  # noqa: BLE001 (whatever a library raises, the sensor is what failed)
            self._note_error(error)
            return False
        return True

    def state(self) -> LinkState:
        """How the link is doing."""
        with self._lock:
            return LinkState(
                connected=self._port is not None,
                since_s=time.monotonic() - self._changed_s,
                openings=self._openings,
                errors=self._errors,
                last_error=self._last_error,
                was_silent=self._was_silent,
                last_error_s=self._last_error_s,
                note=self._note,
                silent_s=time.monotonic() - self._received_s,
                has_received=self._has_received,
            )

    def _run(self) -> None:
        """The loop; leaves only when stopped."""
        pause_s = FIRST_PAUSE_S
        while not self._stopping.is_set():
            received = False
            try:
                self.look = Look(time.monotonic_ns())
                port = self._open_port()
                try:
                    self._set_port(port)
                    self._handlers.on_open()
                    for data, arrival_ns in self._arrivals(port):
                        received = self._has_received = True
                        self._received_s = time.monotonic()
                        self._handlers.on_data(data, arrival_ns)
                finally:
                    self._set_port(None)
                    port.close()
            except Exception as error:  # noqa: BLE001 (whatever a library raises, the sensor is what failed)
                self._note_error(error)
            if self._was_silent:  # it was waited for already: what is sent to a closed port is lost
                continue
            if received:  # a port that opens but never delivers is not tried more often
                pause_s = FIRST_PAUSE_S
            self._stopping.wait(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _arrivals(self, port: Port[T]) -> Iterator[tuple[T, int]]:
        """Everything that arrives until the link is stopped."""
        received_s = time.monotonic()
        while not self._stopping.is_set():
            is_silent = True
            self.look.step(time.monotonic_ns())
            for arrival in port.read():
                self.look.step(time.monotonic_ns())
                is_silent = False
                yield arrival
                if self._stopping.is_set():
                    return
                self.look.step(time.monotonic_ns())
            self.look.found_nothing()
            if not is_silent:
                received_s = time.monotonic()
                continue
            self._handlers.on_silence()
            if time.monotonic() - received_s > self._silence_s:
                raise _Silence(f"nothing received for {self._silence_s:g} s")

    def _set_port(self, port: Port[T] | None) -> None:
        with self._lock:
            self._port = port
            self._changed_s = time.monotonic()
            if port is not None:
                self._openings += 1
                self._note = port.note

    def _note_error(self, error: Exception) -> None:
        with self._lock:
            self._errors += 1
            self._last_error_s = time.time()
            self._was_silent = isinstance(error, _Silence)
            self._last_error = str(error) if self._was_silent else _reason(error)


def _reason(error: Exception) -> str:
    """The system's own words, which libraries wrap into the name of the port, twice; else the error's."""
    inner = error.__cause__ if error.__suppress_context__ else error.__context__
    for cause in (inner, error):
        if isinstance(cause, OSError) and cause.strerror:
            return " ".join(cause.strerror.split())
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


class _Silence(Exception):
    """Nothing comes from a port that is open."""
