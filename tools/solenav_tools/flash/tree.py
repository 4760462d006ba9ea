"""A tree of files onto a board: what has to change, and changing it atomically.

`a/` and `b/` are trees of firmware, the file `active` names the one that boots
(firmware/switch.py). A new one is written into the other folder, each file read back by its
SHA-256, and becomes the active one by the renaming of `active.new`. On a board flashed by hand,
whose files are at the root, the renaming of `main.py.new` is the switch; FAT takes the old name
away first, so for that moment a line in boot.py completes what was cut off. What is the user's or
the run's (config.json, log, state*.bin, a main.py that isn't ours) is not lost, and a changed
config.json travels in the new tree, so that the old one never meets the new one's settings.
"""

from __future__ import annotations

import binascii
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from solenav.errors import SolenavError
from solenav_tools.flash.repl import Repl

TREES = ("a", "b")
_PIECE = 768  # bytes in a call: 1 kB as text, and a multiple of 3
_RESERVE = 65536  # bytes that stay free: checkpoints and the file system's own
_BLOCK = 4096


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@dataclass
class Present:
    """What is on the board: SHA-256 and size by path; the active tree, None before the first."""

    files: dict[str, tuple[str, int]]
    active: str | None
    config: str | None
    config_at: str
    free: int
    by_hand: bool = False  # our files are at the root


@dataclass
class Plan:
    """What there is to do. `send`: by path; `copy`: target to source, both on the board."""

    target: str
    switch: bool = False
    send: dict[str, bytes] = field(default_factory=dict)
    copy: dict[str, str] = field(default_factory=dict)
    remove: list[str] = field(default_factory=list)
    kept: int = 0
    main: bytes | None = None
    over_main: bool = False  # there is one that it replaces
    foreign_main: bool = False  # and that is none of ours
    config: bytes | None = None
    config_at: str = "config.json"

    @property
    def bytes(self) -> int:
        """To go over the wire."""
        return sum(map(len, self.send.values())) + len(self.main or b"") + len(self.config or b"")

    @property
    def nothing(self) -> bool:
        return not (self.switch or self.main is not None or self.config is not None)


def prepare(repl: Repl) -> None:
    """Send the functions that the rest calls."""
    repl.run((Path(__file__).parent / "onboard.py").read_text(encoding="utf-8"))


def look(repl: Repl) -> Present:
    """Read what is there; nothing is changed."""
    names = repl.run("fl_feed()\nprint(os.listdir())")
    files = {}
    listed = repl.run(
        "for n in ('a', 'b'):\n if fl_exists(n): fl_list(n)\n"
        "for n in ('main.py', 'active', 'active.new'):\n"
        " if fl_exists(n): print(fl_digest(n), os.stat(n)[6], n)"
    )
    for line in listed.splitlines():
        sha, size, path = line.split(" ", 2)
        files[path] = (sha, int(size))
    active = None
    for name in ("active", "active.new"):
        known = {digest(tree.encode()): tree for tree in TREES}
        if active is None and name in files:
            active = known.get(files[name][0])
    config, config_at = None, "config.json"
    if active and f"{active}/config.json" in files:
        config_at = f"{active}/config.json"
    if config_at in files or "'config.json'" in names:
        config = repl.run(f"with open({config_at!r}) as f: print(f.read(), end='')")
    free = int(repl.run("print(fl_free())"))
    return Present(files, active, config, config_at, free, "'solenav_core'" in names)


def plan(
    present: Present, tree: Mapping[str, bytes], switch: bytes, config: dict[str, object]
) -> Plan:
    """What has to be done so that the board boots `tree` with `config`.

    SolenavError where the flash is too small for both trees.
    """
    active = present.active
    here = {p: sha for p, (sha, _size) in present.files.items()}
    old = json.loads(present.config) if present.config else None
    changed = json.dumps(config, indent=1).encode() if config != old else None
    main = None if here.get("main.py") == digest(switch) else switch
    over_main = main is not None and "main.py" in here
    foreign = over_main and active is None and not present.by_hand
    wanted = {name: digest(data) for name, data in tree.items()}
    if active and all(here.get(f"{active}/{name}") == sha for name, sha in wanted.items()):
        return Plan(
            active,
            kept=len(tree),
            main=main,
            over_main=over_main,
            config=changed,
            config_at=present.config_at,
        )
    if present.config_at != "config.json":
        # It waits in the tree that goes, and no boot has put it in its place yet.
        changed = json.dumps(config, indent=1).encode()
    target = TREES[1] if active == TREES[0] else TREES[0]
    out = Plan(target, True, main=main, over_main=over_main, foreign_main=foreign, config=changed)
    source = {sha: path for path, sha in here.items() if active and path.startswith(active + "/")}
    for name, data in tree.items():
        path = f"{target}/{name}"
        if here.get(path) == wanted[name]:
            out.kept += 1
        elif wanted[name] in source:
            out.copy[path] = source[wanted[name]]
        else:
            out.send[path] = data
    names = {f"{target}/{name}" for name in tree}
    out.remove = [p for p in here if p.startswith(target + "/") and p not in names]
    replaced = [p for p in here if p.startswith(target + "/") and p not in out.copy]
    gone = sum(_blocks(present.files[p][1]) for p in replaced if p in out.remove or p in out.send)
    sizes = [len(data) for data in out.send.values()]
    sizes += [present.files[path][1] for path in out.copy.values()]
    need = sum(map(_blocks, sizes)) + _RESERVE - gone
    if need > present.free:
        raise SolenavError(
            f"the board has {present.free} bytes free, the new tree beside the old needs {need}",
            "solenav download --erase empties the black box; or remove what is not solenav's",
        )
    return out


def apply(repl: Repl, todo: Plan, progress: Callable[[int], None]) -> str | None:
    """Carry it out; at any moment the board boots the old or the new. `progress`: bytes sent.

    Returns the name under which a main.py of somebody else is kept, None where there was none.
    SolenavError where a file isn't on the board as it was sent, twice; PortVanished.
    """
    sent = 0

    def send(path: str, data: bytes) -> None:
        nonlocal sent
        for attempt in range(2):
            repl.run(f"fl_make({path!r})\nfl_put({path!r}, 'wb', b'')")
            for at in range(0, len(data), _PIECE):
                text = binascii.b2a_base64(data[at : at + _PIECE], newline=False)
                repl.run(f"fl_put({path!r}, 'ab', {text!r})")
                progress(sent + min(at + _PIECE, len(data)))
            if _sha(repl, path) == digest(data):
                break
            if attempt:
                raise SolenavError(
                    f"{path} is not on the board as it was sent",
                    "flash again, with another cable; the board still boots what it did",
                    1,
                )
        sent += len(data)

    for path in todo.remove:
        repl.run(f"fl_remove({path!r})")
    for path, source in todo.copy.items():
        # What the old tree holds was checked when it was listed; the copy may still go wrong.
        repl.run(f"fl_make({path!r})\nfl_copy({source!r}, {path!r})")
        want, got = _sha(repl, source), _sha(repl, path)
        if want != got:
            raise SolenavError(f"{path}: the board's copy differs", "flash again", 1)
    for path, data in todo.send.items():
        send(path, data)
    if todo.config is not None:
        # In a tree that isn't active yet it is nobody's; else renaming it is the switch.
        target = f"{todo.target}/config.json" if todo.switch else "config.json.new"
        send(target, todo.config)
    kept = None
    if todo.main is not None:
        if todo.foreign_main:
            kept = repl.run("print(fl_keep('main.py'))").strip()
        if todo.over_main:
            repl.run("fl_guard()")
        send("main.py.new", todo.main)
    if todo.switch:
        send("active.new", todo.target.encode())
        _rename(repl, "active.new", "active")
    elif todo.config is not None:
        _rename(repl, "config.json.new", todo.config_at)
    if todo.main is not None:
        _rename(repl, "main.py.new", "main.py")
    return kept


def clean(repl: Repl, todo: Plan, tree: Mapping[str, bytes]) -> None:
    """Remove what nothing boots any more: the other tree, and files once copied to the root."""
    other = TREES[1] if todo.target == TREES[0] else TREES[0]
    repl.run("fl_unguard()")
    repl.run(f"fl_remove({other!r})")
    if repl.run("print(fl_exists('solenav_core'))").strip() != "True":
        return
    stems = {name.rpartition(".")[0] for name in tree} - {"main"}
    # The core last: it tells a next flash that something of ours is still there.
    for stem in sorted(stems, key=lambda name: (name.startswith("solenav_core"), name)):
        repl.run(f"fl_remove({stem + '.py'!r})\nfl_remove({stem + '.mpy'!r})")
    repl.run("fl_remove('build.json')\nfl_remove('switch.py')")
    # A folder with files of the user's own stays.
    for folder in ("boards", "solenav_core/tables", "solenav_core"):
        repl.run(f"try: os.rmdir({folder!r})\nexcept OSError: pass")


def _rename(repl: Repl, old: str, new: str) -> None:
    repl.run(f"fl_feed()\nos.rename({old!r}, {new!r})")


def _sha(repl: Repl, path: str) -> str:
    return repl.run(f"print(fl_digest({path!r}))").strip()


def _blocks(size: int) -> int:
    return -(-size // _BLOCK) * _BLOCK
