"""The board that the firmware's `config.json` names for a simulation: pins of the model.

`open_bus(frequency)` takes the bus's pins for a controller at that frequency; SCL_PIN, SDA_PIN
(as GPIO: a bus recovery by hand), READY_PIN (INT) and POWER_PIN (the sensor's supply, low is off)
are numbers for `machine.Pin`.
"""

from boards import Board

from solenav.sim.board import machine
from solenav.sim.board.machine import POWER_PIN, READY_PIN, SCL_PIN, SDA_PIN

baud = 460800  # of the UART; `start` sets the one that was asked for


def open_bus(frequency: int = 400_000) -> machine.I2C:
    """The sensor's bus, its pins taken back from whoever had them."""
    return machine.I2C(freq=frequency)


def open() -> Board:
    """The board's bus, pin and UART, set up."""
    # fmt: off
    return Board(
        open_bus, SCL_PIN, SDA_PIN, machine.Pin(READY_PIN, machine.Pin.IN), machine.UART(baud),
        "simulated", baud, POWER_PIN,
    )
    # fmt: on
