"""Serial ports: opening them, and what their errors mean."""

from __future__ import annotations

import errno
from pathlib import Path

import serial
from serial.tools import list_ports

from solenav.errors import SolenavError

BAUD = 460800


class PortVanished(Exception):
    """The other end is gone: cable pulled, board switched off, or program ended."""


def known_ports() -> str:
    """The serial ports that the system lists, for a person."""
    ports = ", ".join(p.device for p in list_ports.comports())
    return ports or "none: is the board plugged in?"


def open_port(name: str, baud: int = BAUD) -> serial.Serial:
    """Open a port for reading with a timeout of 50 ms. SolenavError says why it can't be."""
    try:
        return serial.Serial(name, baud, timeout=0.05, write_timeout=1.0)
    except serial.SerialException as error:
        raise explained(name, error) from None
    except ValueError as error:
        raise SolenavError(f"{name}: {error}", f"use {BAUD} baud") from None


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
