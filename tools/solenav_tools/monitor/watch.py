"""A board that is watched: read in a thread of its own, so that no drawing ever holds it up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import serial

from solenav.capture import CaptureWriter
from solenav.capture.sidecar import write_sidecar
from solenav.errors import SolenavError
from solenav.link.schema import need_schema
from solenav_tools import settings
from solenav_tools.monitor.live import Live
from solenav_tools.monitor.wearers import Wearer, wearers
from solenav_tools.ports import PortVanished, open_port, reopen
from solenav_tools.recorder import join_in, stream


class Watch:
    """One wearer's board. Hold `lock` while reading `live`."""

    def __init__(self, wearer: Wearer, record_to: Path | None = None) -> None:
        """SolenavError where the port or the file can't be opened."""
        self.wearer = wearer
        self.live = Live()
        self.lock = threading.Lock()
        self.gone = False  # the port is: it is waited for
        self.losses = 0  # times that the port vanished
        self.trouble = ""  # with the recording: it has ended, watching goes on
        self.error: SolenavError | None = None  # watching has ended with it
        self._port: serial.Serial | None = open_port(wearer.port, wearer.baud)
        self._writer: CaptureWriter | None = None
        if record_to is not None:
            self._writer = CaptureWriter(record_to)
            write_sidecar(
                record_to,
                {
                    "port": wearer.port,
                    "baud": wearer.baud,
                    "name": wearer.name,
                    "started": time.time(),
                },
            )
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def recording(self) -> bool:
        return self._writer is not None and not self.trouble

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends the reading, and the recording with all that came."""
        self._over.set()
        self._thread.join()
        if self._writer is not None:
            self._writer.close()

    @property
    def over(self) -> bool:
        """Whether nothing more can come."""
        return not self._thread.is_alive()

    def write(self, arrival: float, data: bytes) -> None:
        """Take the bytes into the recording; a full disk ends only that."""
        if self._writer is None or self.trouble:
            return
        try:
            self._writer.write(arrival, data)
        except SolenavError as error:
            self.trouble = f"recording ended: {error.message}"

    def _run(self) -> None:
        try:
            while self._port is not None:
                try:
                    with self._port:
                        self._follow(self._port)
                    return
                except PortVanished:
                    self.gone = True
                    self.losses += 1
                    wearer = self.wearer
                    self._port = reopen(wearer.port, wearer.baud, self._over.is_set)
                    self.gone = self._port is None
        except SolenavError as error:
            self.error = error

    def _follow(self, port: serial.Serial) -> None:
        join_in(port)
        for item in stream(port, self, self._over.is_set):
            with self.lock:
                self.live.take(item, time.monotonic())
                hello = self.live.hello
            if hello:
                need_schema(hello, self.wearer.name)


@contextmanager
def monitor(*ports: str, baud: int | None = None) -> Iterator[list[Watch]]:
    """The boards at ports, or of names in solenav.toml, read in the background meanwhile.

    Each `Watch` has the board's last word in `live` (`live.as_dict()`), to be read while holding
    its `lock`. SolenavError where a port can't be opened.
    """
    with watching(wearers(ports, settings.load(), baud), lambda _wearer: None) as watches:
        yield watches


@contextmanager
def watching(
    people: list[Wearer], record_to: Callable[[Wearer], Path | None]
) -> Iterator[list[Watch]]:
    """All of them, read from now on. SolenavError where one can't be opened."""
    watches: list[Watch] = []
    try:
        for wearer in people:
            watches.append(Watch(wearer, record_to(wearer)))
            watches[-1].start()
        yield watches
    finally:
        for watch in watches:
            watch.stop()
