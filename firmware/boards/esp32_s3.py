"""ESP32-S3 (DevKitC): sensor on I2C0 (GPIO8 SDA, GPIO9 SCL), INT on GPIO10, link on UART1
(GPIO17 TX, GPIO18 RX).

The sensor's supply isn't switched: VCC is on 3V3.
"""

from machine import I2C, UART, Pin

from boards import Board

_SDA = 8
_SCL = 9
_BAUD = 460800


def open():
    """The board's bus, pins and UART, set up."""
    return Board(
        lambda freq: I2C(0, sda=Pin(_SDA), scl=Pin(_SCL), freq=freq, timeout=10_000),
        _SCL,
        _SDA,
        Pin(10, Pin.IN, Pin.PULL_DOWN),
        UART(1, _BAUD, tx=Pin(17), rx=Pin(18), txbuf=2048, rxbuf=256, timeout=0),
        "ESP32-S3",
        _BAUD,
        None,
    )
