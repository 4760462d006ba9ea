"""The view in a terminal: one wearer in full, several in a table."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table

from solenav_tools.monitor.live import Live, heading_deg, position_m, speed_mps
from solenav_tools.monitor.watch import Watch


def render(watches: Sequence[Watch], now: float) -> RenderableType:
    """What is known of all of them at `now` (s)."""
    if len(watches) == 1:
        watch = watches[0]
        with watch.lock:
            name = f"{escape(watch.wearer.name)} tick {watch.live.tick}"
            return panel(watch.live, f"{name}  {_state(watch, now)}", now)
    table = Table(box=None, pad_edge=False)
    for column in ("", "mode", "E  m", "N  m", "U  m", "m/s", "heading", "steps", "m", "data"):
        table.add_column(column, justify="left" if column in ("", "mode") else "right")
    notes = []
    for watch in watches:
        with watch.lock:
            live = watch.live
            state = _state(watch, now)
            place = ["-"] * 7
            if live.pose:
                east, north, up = position_m(live.pose)
                place = [
                    *(f"{value:.2f}" for value in (east, north, up, speed_mps(live.pose))),
                    f"{heading_deg(live.pose['attitude']):.0f}°",
                    str(live.pose["steps"]),
                    f"{live.pose['distance'] / 1024:.1f}",
                ]
            name = f"[{watch.wearer.colour}]■[/] {escape(watch.wearer.name)}"
            table.add_row(name, escape(live.mode), *place, state)
            for text in [*live.warnings, *list(live.logs)[-1:]]:
                notes.append(f"[{watch.wearer.colour}]■[/] {escape(text)}")
    return Panel(Group(table, *notes))


def panel(live: Live, title: str, now: float) -> RenderableType:
    """All that is known of one wearer; `title` is rich's markup."""
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", style="bold")
    table.add_column()
    for key, value in live.values().items():
        style = "[red]" if key == "warning" else ""
        table.add_row(key, f"{style}{escape(value)}")
    for text in list(live.logs)[-5:-1]:
        table.add_row("", f"[dim]{escape(text)}")
    return Panel(table, title=title, border_style="red" if live.stale(now) else "green")


def _state(watch: Watch, now: float) -> str:
    """How fresh the data are, and whether they go to a file."""
    live = watch.live
    parts = []
    if watch.gone:
        parts.append("[red]unplugged: waiting[/]")
    elif not live.frames:
        parts.append("[yellow]waiting for the board[/]")
    if live.frames and live.stale(now):
        parts.append(f"[red]no data for {now - live.heard:.0f} s[/]")
    if watch.trouble:
        parts.append(f"[red]{escape(watch.trouble)}[/]")
    elif watch.recording:
        parts.append("[green]recording[/]")
    return ", ".join(parts) or "[green]live[/]"
