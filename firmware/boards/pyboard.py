"""Pyboard v1.1: sensor on I2C1 (X9 SCL, X10 SDA), INT on X8, link on UART4 (X1 TX, X2 RX).

The sensor's supply isn't switched. Its UART has no buffer for sending, so that a frame is sent
in pieces as the line takes them: leave samples off (`send_samples`) where STATUS counts drops.
"""

from machine import I2C, UART, Pin

from boards import Board

_SDA = "X10"
_SCL = "X9"
_BAUD = 460800


def open():
    """The board's bus, pins and UART, set up."""
    return Board(
        lambda freq: I2C(1, freq=freq, timeout=10_000),
        _SCL,
        _SDA,
        Pin("X8", Pin.IN, Pin.PULL_DOWN),
        UART(4, _BAUD, rxbuf=256, timeout=0),
        "Pyboard",
        _BAUD,
        None,
    )
