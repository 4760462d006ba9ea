"""Raspberry Pi Pico: sensor on I2C0 (GP4 SDA, GP5 SCL), INT on GP6, link on UART0 (GP0, GP1).

The sensor's supply isn't switched: VCC is on 3V3.
"""

from machine import I2C, UART, Pin

from boards import Board

_SDA = 4
_SCL = 5
_BAUD = 460800


def open():
    """The board's bus, pins and UART, set up."""
    return Board(
        # The timeout is for each transfer: a clock held low must not hold up the loop.
        lambda freq: I2C(0, sda=Pin(_SDA), scl=Pin(_SCL), freq=freq, timeout=10_000),
        _SCL,
        _SDA,
        # Pulled down: a cable that came off must not look like data ready.
        Pin(6, Pin.IN, Pin.PULL_DOWN),
        # timeout 0: a write takes what fits and returns.
        UART(0, _BAUD, tx=Pin(0), rx=Pin(1), txbuf=2048, rxbuf=256, timeout=0),
        "Raspberry Pi Pico",
        _BAUD,
        None,
    )
