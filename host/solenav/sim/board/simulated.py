"""The board that the firmware's `config.json` names for a simulation: pins of the model."""

from boards import Board

from solenav.sim.board import machine

READY_PIN = 6

baud = 460800  # of the UART; `start` sets the one that was asked for


def open() -> Board:
    """The board's bus, pin and UART, set up."""
    # fmt: off
    return Board(
        lambda freq: machine.I2C(freq=freq), 5, 4, machine.Pin(READY_PIN), machine.UART(baud),
        "simulated", baud, None,
    )
    # fmt: on
