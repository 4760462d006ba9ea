"""Draws docs/figures/wiring_BOARD.svg and docs/wiring.md from the boards' own modules.

    python tools/site/wiring.py [--check]

The pins are read from firmware/boards/, so that page and firmware can't part.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BOARDS = {
    "rp2_pico": ("Raspberry Pi Pico", "GP", "3V3 (pin 36)"),
    "rp2_pico2": ("Raspberry Pi Pico 2", "GP", "3V3 (pin 36)"),
    "pyboard": ("Pyboard v1.1", "", "3V3"),
    "esp32_s3": ("ESP32-S3 DevKitC", "GPIO", "3V3"),
}
"""Module in firmware/boards: name, what stands before its pins' numbers, its supply's pin."""

# A Pyboard's UART has no choice of pins, so its module doesn't name them.
_UART_PINS = {"pyboard": ("X1", "X2")}
_COLOURS = {
    "VCC": "#c0392b",
    "GND": "#333333",
    "SDA": "#1f77b4",
    "SCL": "#d9a400",
    "INT": "#2e8b57",
}

_PAGE = """# Wiring

Written by `python tools/site/wiring.py` from the boards' modules in `firmware/boards/`.

The sensor goes onto the right instep, the board to the waist, some 1 m of cable between them. SDA
and SCL each twisted with a ground wire of their own, pull-ups of about 2 kΩ to 3V3 at the board's
end (an MPU-9150 breakout often has 4.7 kΩ or 10 kΩ, which is too weak for 400 kHz over a metre),
100 nF and 10 µF from VCC to GND at the sensor. AD0 to GND. Everything is 3.3 V: never 5 V to VCC of
a bare MPU-9150, nor from the adapter's TX.

The link to a computer is the UART, 460800 baud, through a USB serial adapter of 3.3 V; its TX goes
to the board's RX and its RX to the board's TX. The board's own USB is for [flashing](flash.md)
only, or for power.
"""


class Pins(NamedTuple):
    """As they are printed on the board."""

    sda: str
    scl: str
    ready: str
    tx: str
    rx: str


def pins(board: str) -> Pins:
    """The pins that the board's module uses."""
    text = (ROOT / "firmware" / "boards" / f"{board}.py").read_text(encoding="utf-8")
    before = BOARDS[board][1]
    constants = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    ready = _found(r"Pin\((\"?\w+\"?), Pin\.IN", text)
    if board in _UART_PINS:
        tx, rx = _UART_PINS[board]
    else:
        tx = before + _found(r"tx=Pin\((\w+)\)", text)
        rx = before + _found(r"rx=Pin\((\w+)\)", text)
    return Pins(
        f"{before}{constants['_SDA']}", f"{before}{constants['_SCL']}", before + ready, tx, rx
    )


def _found(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    assert found is not None, f"no {pattern} in the board's module"
    return found[1].strip('"')


def drawing(board: str) -> str:
    """The wiring as SVG."""
    title, _before, supply = BOARDS[board]
    p = pins(board)
    rows = [
        ("GND", "GND"),
        ("VCC", supply),
        ("SDA", p.sda),
        ("SCL", p.scl),
        ("INT", p.ready),
    ]
    out = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 400" font-family="sans-serif"'
        f' font-size="14" role="img" aria-label="Wiring of an MPU-9150 to the {title}">',
        '<rect width="760" height="400" fill="#ffffff"/>',
        _box(20, 30, 150, 250, "MPU-9150", "right instep"),
        _box(430, 30, 150, 350, title, "waist"),
        _box(650, 256, 95, 124, "USB", "serial, 3.3 V"),
    ]
    for i, (here, there) in enumerate(rows):
        y = 100 + 38 * i
        out.append(
            f'<line x1="170" y1="{y}" x2="430" y2="{y}" stroke-width="3"'
            f' stroke="{_COLOURS[here]}"/>'
        )
        out.append(_text(160, y + 5, here, "end") + _text(440, y + 5, there, "start"))
    for i, x in ((2, 340), (3, 380)):
        y = 100 + 38 * i
        out.append(
            f'<path d="M{x} 138V{y - 28}m-6 0h12v18h-12zM{x} {y - 10}V{y}" fill="#ffffff"'
            ' stroke="#333333" stroke-width="1.5"/>'
            f'<circle cx="{x}" cy="138" r="3.5"/><circle cx="{x}" cy="{y}" r="3.5"/>'
        )
    out.append(_text(360, 126, "two of 2 kΩ", "middle", 12))
    for i, (here, there) in enumerate(((p.tx, "RX"), (p.rx, "TX"), ("GND", "GND"))):
        y = 316 + 24 * i
        colour = ("#8e44ad", "#e67e22", "#333333")[i]
        out.append(
            f'<line x1="580" y1="{y}" x2="650" y2="{y}" stroke="{colour}" stroke-width="3"/>'
        )
        mark = f" ({'TX' if i == 0 else 'RX'})" if i < 2 else ""
        out.append(_text(572, y + 5, here + mark, "end") + _text(658, y + 5, there, "start"))
    out.append(
        '<path d="M200 316h200" stroke="#333333" stroke-width="1" stroke-dasharray="4 3"/>'
        + _text(300, 334, "1 m of cable, SDA and SCL each", "middle", 12)
        + _text(300, 350, "twisted with GND", "middle", 12)
    )
    return "\n".join([*out, "</svg>"]) + "\n"


def _box(x: int, y: int, width: int, height: int, title: str, below: str) -> str:
    middle = x + width // 2
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="#f2f5f7"'
        ' stroke="#333333" stroke-width="1.5"/>'
        + _text(middle, y + 22, title, "middle", 14 if width > 100 else 12)
        + _text(middle, y + 40 if width > 100 else y + 18 + 18, below, "middle", 11)
    )


def _text(x: int, y: int, text: str, anchor: str, size: int = 14) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="{size}">{text}</text>'


def page() -> str:
    """docs/wiring.md."""
    parts = [_PAGE]
    for board, (title, _before, supply) in BOARDS.items():
        p = pins(board)
        parts.append(
            f"## {title}\n\n![Wiring of an MPU-9150 to the {title}](figures/wiring_{board}.svg)\n\n"
            f"| MPU-9150 | {title} | |\n|---|---|---|\n"
            f"| VCC, GND | {supply}, GND | |\n"
            f"| SDA, SCL | {p.sda}, {p.scl} | I2C, 400 kHz |\n"
            f"| INT | {p.ready} | data ready |\n"
            f"| | {p.tx} (TX), {p.rx} (RX) | UART to the adapter's RX, TX |\n\n"
            f"`solenav flash --board {board}`\n"
        )
    return "\n".join(parts)


def main() -> int:
    files = {DOCS / "figures" / f"wiring_{board}.svg": drawing(board) for board in BOARDS}
    files[DOCS / "wiring.md"] = page()
    stale = [
        path
        for path, text in files.items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]
    if "--check" in sys.argv:
        for path in stale:
            print(f"{path.relative_to(ROOT)} is stale: python tools/site/wiring.py")
        return 1 if stale else 0
    for path, text in files.items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
