"""A board's raw REPL, through mpremote."""

from __future__ import annotations

import contextlib
import io
import struct
import time
from typing import Any, Protocol

import serial

from solenav.errors import SolenavError
from solenav_tools.ports import PortVanished, explained

_REMEDY = "pip install 'solenav[flash]'"
_SILENT_S = 3.0  # a board that answers at all does so at once
_TRIES = 4  # a watchdog may bite while we get in: the board is back after a second or two


class Repl(Protocol):
    """Where code runs on the board: its output. PortVanished; SolenavError where it raises."""

    def run(self, code: str) -> str: ...


class SerialRepl:
    """The raw REPL at a serial port, the firmware interrupted.

    SolenavError where the port can't be opened, nothing answers, or mpremote is missing.
    """

    def __init__(self, port: str) -> None:
        try:
            from mpremote.transport import TransportError, TransportExecError
            from mpremote.transport_serial import SerialTransport
        except ImportError:
            raise SolenavError("flashing needs mpremote", _REMEDY) from None
        self.port = port
        self._refused: type[Exception] = TransportExecError
        self._broken = (TransportError, serial.SerialException, OSError)
        try:
            # Opened by pyserial first: its errors say why, mpremote's don't.
            serial.serial_for_url(port).close()
        except serial.SerialException as error:
            raise explained(port, error) from None
        last = ""
        for _try in range(_TRIES):
            try:
                self._transport: Any = SerialTransport(port, timeout=_SILENT_S)
            except self._broken as error:
                last = str(error)
                time.sleep(1)
                continue
            try:
                # mpremote prints what it could not make sense of.
                with contextlib.redirect_stdout(io.StringIO()):
                    self._transport.enter_raw_repl(soft_reset=False, timeout_overall=_SILENT_S)
                return
            except self._broken as error:
                last = str(error)
                with contextlib.suppress(*self._broken):
                    self._transport.serial.close()
        raise SolenavError(
            f"{port}: no MicroPython REPL answers ({last})",
            "name the board's own USB port, not the UART adapter; else switch it off and on, and "
            "try within 8 s; a board without MicroPython needs its UF2 first",
        )

    def run(self, code: str) -> str:
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                out: bytes = self._transport.exec(code)
        except self._refused as error:
            raise SolenavError(
                f"{self.port}: the board could not do it: {str(error).strip().splitlines()[-1]}",
                "flash again; the firmware that was there still is",
                1,
            ) from None
        except (*self._broken, TypeError, IndexError, ValueError, struct.error) as error:
            raise PortVanished(f"{self.port}: {error}") from None
        return out.decode("utf-8", "replace").replace("\r\n", "\n")

    def reset(self) -> None:
        """Restart the board; the port may vanish with it."""
        with contextlib.suppress(*self._broken):
            self._transport.exec_raw_no_follow("import machine\nmachine.reset()")
            time.sleep(0.2)

    def close(self) -> None:
        with contextlib.suppress(*self._broken):
            self._transport.serial.close()
