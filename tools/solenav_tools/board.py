"""The simulated board: the firmware on MicroPython's unix port behind a pseudo-terminal.

A run is as fast as the machine allows, and the same to the byte each time.
"""

from __future__ import annotations

import json
import os
import select
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError, unreadable
from solenav.sim.board.faults import problem
from solenav.sim.board.machine import RESTARTS
from solenav.sim.feed_file import RECORD, write_feed
from solenav_tools.micropython import find_micropython
from solenav_tools.ports import BAUD
from solenav_tools.staging import stage

if sys.platform != "win32":
    import fcntl
    import termios
    import tty

SENSORS = ("MPU-9150", "MPU-6050", "none")
FLASH_SETTINGS = ("capacity", "torn")

_RESTARTS_MAX = 1000  # a firmware that restarts for ever before the recording begins


class Samples(NamedTuple):
    """What the sensor will measure: the arguments of `write_feed`."""

    time_us: NDArray[np.int64]
    counts: NDArray[np.int16]
    temperature: NDArray[np.int16]
    mag: NDArray[np.int16] | None = None


class SimulatedBoard:
    """A board to be opened by pyserial at `port`, within a ``with``.

    The board is switched on when the first client opens the port as pyserial does, discarding
    what came before: so the client misses nothing, and two runs give the same bytes. When the
    feed is over the firmware sends what it has and ends; once the client has read it all, the
    port vanishes for it as a pulled cable does. Where no client reads, the board waits.

    `feed`: a feed file or samples. `config`: keys of the firmware's config.json. `realtime`:
    simulated time is never ahead of the wall clock. `sensor`: one of SENSORS. `baud`: of the
    simulated UART. `faults`: a script as `solenav.sim.board.faults` describes it. `flash`:
    `capacity` in bytes, `torn` (`solenav.sim.board.flash`).

    A watchdog reset, machine.reset() or power cut is a process that ends; the next one goes on
    over the same folder (the flash) and port. `restarts` says why each began: "reset",
    "watchdog" or "power". After a process has ended `rejected` holds the writes that the sensor
    didn't take so far, and `report` the state that it left: among others "flash", how many
    operations on it there were and how many bytes were written.
    """

    def __init__(
        self,
        feed: Path | Samples,
        config: Mapping[str, Any] | None = None,
        realtime: bool = False,
        *,
        sensor: str = SENSORS[0],
        baud: int = BAUD,
        faults: Sequence[Mapping[str, Any]] = (),
        flash: Mapping[str, Any] | None = None,
    ) -> None:
        if sensor not in SENSORS:
            raise SolenavError(
                f"no simulated sensor {sensor!r}", f"choose one of {', '.join(SENSORS)}"
            )
        for fault in faults:
            if wrong := problem(dict(fault)):
                raise SolenavError(f"no fault that can be simulated: {wrong}", "change the script")
        if unknown := set(flash or {}) - set(FLASH_SETTINGS):
            raise SolenavError(
                f"the simulated flash has no setting {sorted(unknown)[0]!r}",
                f"choose from {', '.join(FLASH_SETTINGS)}",
            )
        self._feed = feed
        self._config = dict(config or {})
        self._settings = {
            "sensor": sensor,
            "baud": baud,
            "realtime": realtime,
            "faults": [dict(fault) for fault in faults],
            "flash": dict(flash or {}),
        }
        self.port = ""
        self.stderr = ""
        self.restarts: list[str] = []
        self.report: dict[str, Any] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False
        self._closing = threading.Event()
        self._ended = threading.Event()
        # Not Thread.join, which doesn't wait any more once Ctrl-C has broken into it.
        self._over = threading.Event()
        self._lock = threading.Lock()

    def __enter__(self) -> SimulatedBoard:
        """SolenavError: no pseudo-terminals here, no MicroPython, or no such feed file."""
        if sys.platform == "win32":
            raise SolenavError(
                "the simulated board needs pseudo-terminals, which Windows doesn't have",
                "run it under Linux, macOS or WSL, or use a real board",
            )
        self._micropython = find_micropython()
        self._folder = tempfile.TemporaryDirectory(prefix="solenav-board-")
        try:
            self._fill(Path(self._folder.name))
        except BaseException:
            self._folder.cleanup()
            raise
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        # Packet mode: the master sees when a client discards its input.
        fcntl.ioctl(self._master, termios.TIOCPKT, struct.pack("i", 1))
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._attend, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def wait(self, timeout: float | None = None) -> int:
        """Until the firmware has ended: its exit code. TimeoutError after `timeout` seconds."""
        if not self._ended.wait(timeout):
            raise TimeoutError(f"the simulated board still runs after {timeout} s")
        return self._process.returncode if self._process else 0

    def wait_until_read(self) -> None:
        """Until the firmware has ended and a client has read all that it sent."""
        self._over.wait()

    def check(self) -> None:
        """SolenavError with the traceback, if the firmware has crashed."""
        if self._process and not self._stopped and self._process.returncode:
            code = self._process.returncode
            raise SolenavError(
                f"the firmware on the simulated board ended with exit code {code}:\n{self.stderr}",
                "report it with this text",
                1,
            )

    def close(self) -> None:
        """Switch the board off, at once."""
        with self._lock:
            self._closing.set()
            self._stopped = not self._ended.is_set()
            if self._process and self._process.poll() is None:
                self._process.terminate()
        self._over.wait()
        self._folder.cleanup()

    def _fill(self, folder: Path) -> None:
        stage(folder, self._config)
        (folder / "board.json").write_text(json.dumps(self._settings), encoding="utf-8")
        inside = folder / "feed.bin"
        if isinstance(self._feed, Samples):
            write_feed(inside, *self._feed)
            return
        try:
            size = self._feed.stat().st_size
        except OSError as error:
            raise unreadable(self._feed, error) from None
        if size % RECORD.itemsize:
            raise SolenavError(
                f"{self._feed} is no feed file: {size} bytes, records have {RECORD.itemsize}",
                "make one with solenav.sim.feed_file",
            )
        inside.symlink_to(self._feed.resolve())

    def _attend(self) -> None:
        """The board's life, in a thread of its own."""
        try:
            if self._client_came() and self._switched_on():
                self._let_client_read()
        finally:
            self._ended.set()
            # With the last master the slave's unread bytes are gone and its readers see the end.
            os.close(self._slave)
            os.close(self._master)
            self._over.set()

    def _client_came(self) -> bool:
        """Wait until a client has opened the port; False when closing."""
        poll = select.poll()
        poll.register(self._master, select.POLLIN | select.POLLPRI)
        came = False
        while not came and not self._closing.is_set():
            if poll.poll(50):
                # One byte is the packet's kind alone: what the client sent stays where it is.
                (kind,) = os.read(self._master, 1)
                came = kind == termios.TIOCPKT_DATA or bool(kind & termios.TIOCPKT_FLUSHREAD)
        fcntl.ioctl(self._master, termios.TIOCPKT, struct.pack("i", 0))
        return came

    @property
    def rejected(self) -> list[tuple[int, int, int, int, str]]:
        """(time in µs since power-up, address, register, value, reason) of each."""
        sensor = self.report.get("sensor") or {"rejected": []}
        return [tuple(entry) for entry in sensor["rejected"]]

    @property
    def folder(self) -> Path:
        """The flash, as a folder; it is there until the board is closed."""
        return Path(self._folder.name)

    def _switched_on(self) -> bool:
        """Run the firmware to its end, through all restarts; False when closing."""
        while self._lived():
            code = self._process.returncode if self._process else 0
            if code not in RESTARTS or len(self.restarts) >= _RESTARTS_MAX:
                break
            self.restarts.append(RESTARTS[code])
        self._ended.set()
        return not self._closing.is_set()

    def _lived(self) -> bool:
        """Run the firmware until its process ends; False when closing."""
        folder = self.folder
        errors = folder / "stderr"
        with self._lock, errors.open("ab") as stderr:
            if self._closing.is_set():
                return False
            self._process = subprocess.Popen(
                [self._micropython, "solenav/sim/board/start.py"],
                cwd=folder,
                stdin=self._master,
                stdout=self._master,
                stderr=stderr,
                start_new_session=True,  # Ctrl-C is for the client
            )
        self._process.wait()
        self.stderr = errors.read_text(encoding="utf-8", errors="replace")
        state = folder / "board.state"
        if state.is_file():
            self.report = json.loads(state.read_text(encoding="utf-8"))
        return not self._closing.is_set()

    def _let_client_read(self) -> None:
        """Until the port's input has stayed empty, or closing."""
        empty = 0
        # More than one look: the kernel hands bytes on to an emptied input after a while.
        while empty < 5 and not self._closing.wait(0.02):
            waiting = fcntl.ioctl(self._slave, termios.FIONREAD, b"\0" * 4)
            empty = 0 if any(waiting) else empty + 1
