"""The monitor's page: who may see it, what it sends, and how it looks in a browser."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from cli import SOLENAV, refused
from test_monitor import Cable, frames, pose, wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from solenav import capture
from solenav.link import encode
from solenav_core import messages
from solenav_tools.monitor.live import Live
from solenav_tools.monitor.wearers import Wearer
from solenav_tools.monitor.web import Feed


@pytest.fixture(scope="module")
def stream(replayed: Path) -> bytes:
    return b"".join(data for _t, data in capture.read_records(replayed))


@contextmanager
def served(*arguments: str | Path) -> Iterator[str]:
    """The page's address, from the command that serves it."""
    command = [SOLENAV, "monitor", *arguments, "--web", "--http-port", "0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        yield process.stderr.readline().strip()
    finally:
        process.send_signal(2)
        process.wait(60)
        assert process.returncode in (0, 1)


@pytest.fixture
def cables(tmp_path: Path) -> Iterator[list[Cable]]:
    made = [Cable(tmp_path / name) for name in ("one", "two")]
    for cable in made:
        cable.plug()
    yield made
    for cable in made:
        if cable._ends:
            cable.pull()


def get(url: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    answer = httpx.get(url, headers=headers)
    return answer.status_code, dict(answer.headers), answer.content


def feed(url: str, **options: Any) -> Any:
    host = re.match(r"http://([^/]+)", url)
    assert host is not None
    options.setdefault("origin", f"http://{host[1]}")
    return connect(f"ws://{host[1]}/feed", **options)


def test_the_page_sends_every_wearer_with_its_way(cables: list[Cable], stream: bytes) -> None:
    data = stream[:120_000]
    with served(f"ann={cables[0].name}", f"bob={cables[1].name}") as url:
        for cable in cables:
            cable.send(data)
        poses = [f for f in frames(data) if f.kind == messages.POSE]
        with feed(url) as socket:
            got: dict[str, list[float]] = {"ann": [], "bob": []}
            state: dict[str, Any] = {}
            while min(len(times) for times in got.values()) < len(poses):
                for message in json.loads(socket.recv(timeout=30)):
                    if message["reset"]:
                        got[message["name"]] = []
                    got[message["name"]] += [point[0] for point in message["recent"]]
                    state[message["name"]] = message
        # Who comes late gets what was before; nobody gets anything twice.
        with feed(url) as late:
            first = json.loads(late.recv(timeout=30))[0]
    assert got["ann"] == got["bob"] == sorted(set(got["ann"]))
    assert state["ann"]["colour"] != state["bob"]["colour"]
    assert state["ann"]["tick"] == frames(data)[-1].tick
    assert len(first["recent"]) == len(poses) and first["reset"]


def test_only_this_machine_s_own_page_may_listen(cables: list[Cable]) -> None:
    with served(cables[0].name) as url:
        assert url.startswith("http://127.0.0.1:")
        status, headers, content = get(url)
        assert status == 200 and b"solenav" in content
        assert "default-src 'self'" in headers["content-security-policy"]
        # A name that somebody's DNS points at this machine.
        assert get(url, Host="evil.example")[0] == 403
        for origin in ("http://evil.example", None):
            with (
                pytest.raises((InvalidStatus, ConnectionClosed)),
                feed(url, origin=origin) as socket,
            ):
                socket.recv(timeout=10)
        for path in ("../live.py", "..%2flive.py", "%2e%2e/live.py", "live.py", "view.jsx"):
            assert get(url + path)[0] == 404, path


def test_for_others_there_is_a_token(cables: list[Cable]) -> None:
    with served(cables[0].name, "--host", "0.0.0.0") as shown:
        address, _, token = shown.partition("?token=")
        url = address.replace("0.0.0.0", "127.0.0.1")
        assert len(token) >= 20
        assert get(url)[0] == 403
        assert get(f"{url}?token={token[:-1]}x")[0] == 403
        status, headers, _content = get(f"{url}?token={token}")
        assert status == 303 and headers["location"] == "/"
        cookie = headers["set-cookie"]
        assert "httponly" in cookie.lower() and "samesite=strict" in cookie.lower()
        kept = cookie.split(";")[0]
        assert get(url, Cookie=kept)[0] == 200
        with pytest.raises((InvalidStatus, ConnectionClosed)), feed(url) as socket:
            socket.recv(timeout=10)
        with feed(url, additional_headers={"Cookie": kept}) as socket:
            assert json.loads(socket.recv(timeout=30))[0]["name"] == "one"


def test_a_taken_port_is_told(cables: list[Cable]) -> None:
    with served(cables[0].name) as url:
        number = url.rstrip("/").rsplit(":", 1)[1]
        done = subprocess.run(
            [SOLENAV, "monitor", cables[1].name, "--web", "--http-port", number],
            capture_output=True,
            text=True,
            timeout=60,
        )
        refused(done, 2, "can't serve on 127.0.0.1", "--http-port")


def test_a_browser_that_sleeps_holds_up_nothing(
    cables: list[Cable], stream: bytes, tmp_path: Path
) -> None:
    kept = tmp_path / "kept.solcap"
    with served(cables[0].name, "-o", kept) as url, feed(url, max_queue=1):
        # It never reads. All the same everything is recorded.
        cables[0].send(stream)
        wait_for(lambda: kept.stat().st_size > len(stream))
    assert b"".join(data for _t, data in capture.read_records(kept)) == stream


class _Watched:
    """What a feed asks of a watch."""

    def __init__(self) -> None:
        self.live = Live()
        self.lock = threading.Lock()
        self.wearer = Wearer("ann", "port", 460800, "#112233")
        self.gone = self.recording = False
        self.trouble = ""


def test_a_feed_sends_what_is_new_and_says_when_the_old_is_void() -> None:
    watched = _Watched()
    reader = Feed(watched)  # type: ignore[arg-type]
    for tick in range(1, 301):
        watched.live.take(pose(tick), 0.0)
    first = reader.news(0.0)
    assert (first["reset"], len(first["recent"]), len(first["way"])) == (True, 300, 300)
    watched.live.take(pose(301), 0.0)
    second = reader.news(0.0)
    assert (second["reset"], len(second["recent"]), len(second["way"])) == (False, 1, 1)
    for tick in range(302, 9000):
        watched.live.take(pose(tick), 0.0)
    third = reader.news(0.0)
    assert third["reset"] and len(third["way"]) == len(watched.live.way)
    assert reader.news(5.0)["stale"] and not reader.news(0.5)["stale"]


# The page in a browser.

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium; skips without one, but not in CI."""
    if CHROMIUM is None or shutil.which("chromedriver") is None:
        if os.environ.get("CI"):
            pytest.fail("CI has to try the page: chromium and chromedriver are missing")
        pytest.skip("chromium and chromedriver are not installed")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--window-size=1200,800",
    ):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
    made = webdriver.Chrome(options=options, service=service)
    yield made
    made.quit()


def text(browser: Any) -> str:
    return str(browser.find_element("id", "wearers").text)


def dark_pixels(browser: Any, canvas: str) -> int:
    """Pixels of a canvas that something was drawn on."""
    return int(
        browser.execute_script(
            f"const c = document.getElementById('{canvas}');"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 100; return n;"
        )
    )


def picture(browser: Any, name: str) -> None:
    """For people to look at, where SOLENAV_PICTURES names a folder."""
    folder = os.environ.get("SOLENAV_PICTURES")
    if folder:
        browser.save_screenshot(str(Path(folder) / f"{name}.png"))


def test_the_page_shows_tracks_strips_and_what_is_stale(
    cables: list[Cable], stream: bytes, browser: Any
) -> None:
    with served(f"ann={cables[0].name}", f"bob={cables[1].name}") as url:
        cables[0].send(stream)
        cables[1].send(stream[: len(stream) // 2])
        browser.get(url)
        wait_for(lambda: text(browser).count("no data for") == 2)
        assert "ann" in text(browser) and "bob" in text(browser) and "steps" in text(browser)
        for canvas in ("track", "speed", "stance", "confidence"):
            assert dark_pixels(browser, canvas) > 100, canvas
        picture(browser, "wide")
        browser.set_window_size(420, 900)
        picture(browser, "phone")
        width = browser.execute_script("return document.documentElement.scrollWidth")
        assert width <= browser.execute_script("return window.innerWidth"), "it needs no scrolling"
        browser.set_window_size(1200, 800)
        cables[1].pull()
        wait_for(lambda: "unplugged" in text(browser))
        assert not [e for e in browser.get_log("browser") if e["level"] == "SEVERE"]
    wait_for(lambda: "lost" in browser.find_element("id", "connection").text)


def test_the_page_can_be_moved_and_follows_again(
    cables: list[Cable], stream: bytes, browser: Any
) -> None:
    from selenium.webdriver.common.keys import Keys

    with served(cables[0].name) as url:
        cables[0].send(stream[:100_000])
        browser.get(url)
        wait_for(lambda: dark_pixels(browser, "track") > 100)
        follow = browser.find_element("id", "follow")
        track = browser.find_element("id", "track")
        track.send_keys(Keys.ARROW_LEFT)
        assert follow.get_attribute("aria-pressed") == "false"
        follow.click()
        assert follow.get_attribute("aria-pressed") == "true"
        browser.find_element("id", "closer").click()
        assert follow.get_attribute("aria-pressed") == "false"


def test_what_comes_over_the_wire_is_text_and_nothing_else(
    cables: list[Cable], stream: bytes, browser: Any
) -> None:
    evil = b"\x02<img src=x onerror=\"document.title='owned'\"><b>bold</b>"
    with served(f"<i>ann</i>={cables[0].name}") as url:
        cables[0].send(stream[:30_000] + b"\0" + encode(messages.LOG, 0, 9999, evil))
        browser.get(url)
        wait_for(lambda: "<b>bold</b>" in text(browser))
        assert "<i>ann</i>" in text(browser)
        time.sleep(0.3)
        assert browser.title == "solenav"
        assert not browser.find_elements("css selector", "#wearers img, #wearers b, #wearers i")
