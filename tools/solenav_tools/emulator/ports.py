"""The emulated board's UART and USB console, for other programs: pseudo-terminals or TCP.

Emulated time is then never ahead of the wall clock: who waits a second for an answer waits a
second of the board's.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import time
from collections.abc import Callable
from typing import Protocol

from solenav.errors import SolenavError
from solenav_tools.emulator.pico import EmulatedPico

if sys.platform != "win32":
    import termios
    import tty

_CHUNK = 4096
_WAITING_MAX = 1 << 18  # bytes for a client that doesn't read; older ones go, as on a wire
_AHEAD_S = 0.002


class Port(Protocol):
    """Where a client connects: `name` for pyserial."""

    name: str

    def exchange(self, data: bytes) -> bytes:
        """Send; what has come. Never waits."""

    def close(self) -> None: ...


class PseudoTerminal:
    """A pseudo-terminal, open as long as this is; clients come and go."""

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise SolenavError("there are no pseudo-terminals on Windows", "use --tcp")
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.name = os.ttyname(self._slave)
        self._waiting = bytearray()

    def exchange(self, data: bytes) -> bytes:
        self._waiting += data
        del self._waiting[: max(0, len(self._waiting) - _WAITING_MAX)]
        try:
            while self._waiting:
                del self._waiting[: os.write(self._master, self._waiting[:_CHUNK])]
        except BlockingIOError:
            pass
        try:
            return os.read(self._master, _CHUNK)
        except (BlockingIOError, OSError):
            return b""

    def close(self) -> None:
        # With the last master the port vanishes for its clients as a pulled cable does.
        os.close(self._slave)
        os.close(self._master)


class TcpPort:
    """A TCP port on this machine alone; one client at a time, the next when it has gone."""

    def __init__(self, number: int) -> None:
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", number))
        except (OSError, OverflowError) as error:
            self._listener.close()
            raise SolenavError(f"can't open TCP port {number}: {error}", "choose another") from None
        self._listener.listen(1)
        self._listener.setblocking(False)
        self.name = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._client: socket.socket | None = None
        self._waiting = bytearray()

    def exchange(self, data: bytes) -> bytes:
        if self._client is None:
            try:
                self._client, _address = self._listener.accept()
            except BlockingIOError:
                return b""
            self._client.setblocking(False)
            self._waiting.clear()
        self._waiting += data
        del self._waiting[: max(0, len(self._waiting) - _WAITING_MAX)]
        came = b""
        try:
            came = self._client.recv(_CHUNK)
            if not came:
                self._leave()
                return b""
        except BlockingIOError:
            pass
        except OSError:
            self._leave()
            return b""
        try:
            while self._waiting:
                del self._waiting[: self._client.send(self._waiting)]
        except BlockingIOError:
            pass
        except OSError:
            self._leave()
        return came

    def close(self) -> None:
        self._leave()
        self._listener.close()

    def _leave(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def serve(
    pico: EmulatedPico,
    uart: Port,
    console: Port,
    *,
    until: Callable[[], bool] = lambda: False,
) -> None:
    """Run the board between its ports until its recording is over, or `until` says so."""
    from_uart = bytearray()
    from_console = bytearray()
    pico.on_uart = lambda byte, _ns: from_uart.append(byte)
    pico.console.on_data = from_console.extend
    began = time.monotonic() - pico.ns * 1e-9

    def exchange() -> bool:
        came = uart.exchange(bytes(from_uart))
        from_uart.clear()
        if came:
            pico.uart.receive(came)
        if not pico.console.full:
            typed = console.exchange(bytes(from_console))
            from_console.clear()
            if typed:
                pico.console.write(typed)
        return until()

    def paced() -> bool:
        if exchange():
            return True
        nonlocal began
        ahead = pico.ns * 1e-9 - (time.monotonic() - began)
        while ahead > _AHEAD_S:
            select.select([], [], [], min(ahead, 0.005))
            if exchange():
                return True
            ahead = pico.ns * 1e-9 - (time.monotonic() - began)
        if ahead < -0.5:
            # Slower than real: it doesn't run to catch up.
            began = time.monotonic() - pico.ns * 1e-9
        return pico.over

    pico.run(paced)
    exchange()
