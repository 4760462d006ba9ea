"""Raspberry Pi Pico 2: the Pico's pins. Sensor on I2C0 (GP4 SDA, GP5 SCL), INT on GP6, link on
UART0 (GP0, GP1).

The sensor's supply isn't switched: VCC is on 3V3. Of the RP2350's errata E9 holds a pulled-down
input near 2 V once it was high and let go; the sensor drives INT, so that only a cable that came
off could stay high, and the sampler's time-out sees that.
"""

from machine import I2C, UART, Pin

from boards import Board

_SDA = 4
_SCL = 5
_BAUD = 460800


def open():
    """The board's bus, pins and UART, set up."""
    return Board(
        lambda freq: I2C(0, sda=Pin(_SDA), scl=Pin(_SCL), freq=freq, timeout=10_000),
        _SCL,
        _SDA,
        Pin(6, Pin.IN, Pin.PULL_DOWN),
        UART(0, _BAUD, tx=Pin(0), rx=Pin(1), txbuf=2048, rxbuf=256, timeout=0),
        "Raspberry Pi Pico 2",
        _BAUD,
        None,
    )
