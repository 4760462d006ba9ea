"""Serial ports: opening them, and what their errors mean."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from pathlib import Path

import serial
from serial.tools import list_ports

from solenav.errors import SolenavError
from solenav_tools import settings

BAUD = 460800
_WAIT_S = 0.2


class PortVanished(Exception):
    """The other end is gone: cable pulled, board switched off, or program ended."""


def known_ports() -> str:
    """The serial ports that the system lists, for a person."""
    ports = ", ".join(p.device for p in list_ports.comports())
    return ports or "none: is the board plugged in?"


def known_names() -> list[str]:
    """What a shell completes: the names of solenav.toml and the ports that the system lists."""
    try:
        named = list(settings.load().ports)
    except SolenavError:
        named = []
    return named + [port.device for port in list_ports.comports()]


def chosen_port(name: str | None) -> str:
    """The port that was named, else the settings' default, else the only one on USB.

    SolenavError where none was named and there isn't just one.
    """
    chosen = name or settings.load().default_port
    if chosen:
        return chosen
    # A computer's own serial ports have no board on them.
    ports = [port.device for port in list_ports.comports() if port.vid is not None]
    if len(ports) != 1:
        raise SolenavError("which port?", f"name one; ports here: {known_ports()}")
    return ports[0]


def open_port(name: str, baud: int | None = None) -> serial.Serial:
    """Open a port, or one by its name in solenav.toml, for reading with a timeout of 50 ms.

    SolenavError says why it can't be.
    """
    known = settings.load().port(name)
    name = known.device
    baud = baud or known.baud or BAUD
    try:
        return serial.Serial(name, baud, timeout=0.05, write_timeout=1.0)
    except serial.SerialException as error:
        raise explained(name, error) from None
    except ValueError as error:
        raise SolenavError(f"{name}: {error}", f"use {BAUD} baud") from None


def reopen(name: str, baud: int | None, over: Callable[[], bool]) -> serial.Serial | None:
    """Wait for a port that vanished, and open it; None where `over` said that it is enough."""
    while not over():
        try:
            return open_port(name, baud)
        except SolenavError:
            time.sleep(_WAIT_S)
    return None


def explained(name: str, error: serial.SerialException) -> SolenavError:
    """Why a port could not be opened, for a person."""
    if error.errno == errno.ENOENT or "FileNotFoundError" in str(error):
        return SolenavError(f"there is no port {name}", f"ports here: {known_ports()}")
    if error.errno == errno.EACCES or "PermissionError" in str(error):
        return SolenavError(
            f"no permission to open {name}",
            "add yourself to the group that owns it (often `dialout`), log in anew",
        )
    if error.errno == errno.EBUSY:
        return SolenavError(f"{name} is in use", "close the other program that has it open")
    if Path(name).exists():
        return SolenavError(f"{name} is no serial port", f"ports here: {known_ports()}")
    return SolenavError(f"can't open {name}: {error}", f"ports here: {known_ports()}")


def read_some(port: serial.Serial) -> bytes:
    """What has arrived, or b"" after the timeout. PortVanished where the other end is gone."""
    try:
        return port.read(max(1, min(port.in_waiting, 4096)))
    except (serial.SerialException, OSError) as error:
        raise PortVanished(str(error)) from None


def send(port: serial.Serial, data: bytes) -> None:
    """Write a command. PortVanished where the other end is gone or takes nothing."""
    try:
        port.write(data)
    except (serial.SerialException, OSError) as error:
        raise PortVanished(str(error)) from None
