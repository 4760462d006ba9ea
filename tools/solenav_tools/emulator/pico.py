"""The emulated board: UF2 and files in, UART and USB console out, on the processor's own time."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from rp2040py.boards import BOARDS, resolve_firmware
from rp2040py.device import MicroPythonDevice, ResetCause
from rp2040py.memory_map import FLASH_START_ADDRESS

from solenav.errors import SolenavError
from solenav.sim.board import machine
from solenav.sim.board.faults import problem
from solenav.sim.feed_file import write_feed
from solenav_tools.board import Samples
from solenav_tools.emulator import image
from solenav_tools.emulator.sensor import Wiring
from solenav_tools.emulator.workarounds import (
    Console,
    PacedUart,
    StillPio,
    check_version,
    shorten_bus_calls,
)

_TURN_NS = 1e6  # from one look at what comes from outside to the next
_DRAIN_S = 0.3  # after the last sample, for a full FIFO

# Faults of a script that this board can't have.
_NOT_HERE = ("flash_full",)


class EmulatedPico:
    """A Pico, within a ``with``; it runs only while `run` is called.

    `uf2`: MicroPython. `files`: the image of its file system; None: an empty one. `feed`, `sensor`,
    `faults`: as of `SimulatedBoard`. Without a feed there is no sensor.

    `on_uart(byte, ns)` is called with each byte that has left the UART, and when. `uart` and
    `console` take what is sent to the board. The same samples give the same bytes at the same
    times, as long as what is sent to it is sent at the same times.
    """

    def __init__(
        self,
        uf2: Path,
        files: bytes | None = None,
        feed: Path | Samples | None = None,
        *,
        sensor: str = "MPU-9150",
        faults: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        check_version()
        for fault in faults:
            wrong = problem(dict(fault))
            if fault.get("kind") in _NOT_HERE or {"operation", "byte"} & set(fault):
                wrong = "the emulated board's flash has no faults"
            if wrong:
                raise SolenavError(f"no fault that can be emulated: {wrong}", "change the script")
        self.on_uart: Callable[[int, int], None] = lambda byte, ns: None
        self.restarts: list[str] = []
        self._folder = tempfile.TemporaryDirectory(prefix="solenav-pico-")
        try:
            self._boot(uf2, files, self._fed(feed), sensor, [dict(fault) for fault in faults])
        except BaseException:
            self._folder.cleanup()
            raise

    def _fed(self, feed: Path | Samples | None) -> Path | None:
        if not isinstance(feed, Samples):
            return feed
        path = Path(self._folder.name) / "feed.bin"
        write_feed(path, *feed)
        return path

    def _boot(
        self,
        uf2: Path,
        files: bytes | None,
        feed: Path | None,
        sensor: str,
        faults: list[dict[str, Any]],
    ) -> None:
        board = resolve_firmware(BOARDS["pico"], "micropython", str(uf2))
        self._device = MicroPythonDevice(board=board)
        self.mcu = self._device.mcu
        self.simulator = self._device.simulator
        self._pio = StillPio(self.mcu)
        shorten_bus_calls(self.mcu)
        content = image.build({}) if files is None else files
        self.mcu.flash[image.START : image.START + len(content)] = content
        self.uart = PacedUart.install(self.mcu, 0)
        self.uart.on_byte = lambda byte: self.on_uart(byte, self.ns)
        self.console = Console(self._device.cdc)
        self.mcu.watchdog.on_watchdog_trigger = self._bitten
        self.wiring = Wiring(self.mcu, self.uart, feed, sensor, faults, self._halt)
        self._turn_alarm = self.mcu.clock.create_alarm(self._turn)
        self._turn_alarm.schedule(_TURN_NS)
        self.mcu.core.pc = FLASH_START_ADDRESS

    def __enter__(self) -> EmulatedPico:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._folder.cleanup()

    @property
    def ns(self) -> int:
        """Emulated time since power-up."""
        return int(self.mcu.clock.nanos + 0.5)

    @property
    def over(self) -> bool:
        """Whether the recording is, the FIFO is empty, and what was made of it has left."""
        playback, sensor = self.wiring.playback, self.wiring.sensor
        if not (playback and sensor and playback.over):
            self._over_at = -1
            return False
        if self._over_at < 0:
            self._over_at = self.ns
        return self.ns - self._over_at > _DRAIN_S * 1e9 and self.uart.line_idle

    _over_at = -1

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """On, until `until` says so; it is asked at each millisecond of emulated time."""
        while not until():
            self.step()

    def step(self) -> None:
        """On, to the next millisecond of emulated time or to an event that stops the processor."""
        self.simulator.stopped = False
        # A batch also ends when the wall clock says so, which nothing here may depend on.
        while not self.simulator.stopped:
            self.simulator._execute_batch()
        behind = self.wiring.behind_ns
        if behind >= 1000:
            # A fault: the processor stands still while the time goes on.
            self.mcu.clock.tick(behind)
            self.wiring.follow()
        if self.wiring.ended >= 0:
            raise SolenavError(f"the script ended the processor ({self.wiring.ended})", "")

    def file_system(self) -> bytes:
        """The image that is in flash now."""
        return bytes(self.mcu.flash[image.START : image.START + image.BLOCK * image.BLOCKS])

    def _halt(self) -> None:
        self.simulator.stopped = True

    def _turn(self) -> None:
        self._halt()
        self._turn_alarm.schedule(_TURN_NS)

    def _bitten(self) -> None:
        """The watchdog restarts the processor, by itself or as `machine.reset()` has it do."""
        self.restarts.append("watchdog" if self.mcu.watchdog._reason == 1 else "reset")
        machine.bus.end()
        with self._pio.there():
            self._device.hard_reset(cause=ResetCause.WATCHDOG)
