"""A real 32-bit MicroPython: Debian's armhf package under Debian's qemu.

    python -m solenav_tools.micropython32     prints its command line, or why it can't be had

Packages come from the machine's own Debian mirror, of one fixed release whatever the machine's
is, through an apt whose configuration, lists and archives live in the cache folder: nothing is
installed, and the system's apt notices nothing.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from solenav.engines.fast import cache_folder
from solenav.errors import SolenavError

if sys.platform != "win32":
    import fcntl

CODENAME = "trixie"
# The release's names on a mirror, now and later: a mirror may hold one of them half renewed.
SUITES = (CODENAME, "stable", "oldstable")
_ETC = Path("/etc/apt")
_TIMEOUT = 600  # s for one step; the longest is 71 MB of emulator over a poor line
_REMEDY = "have apt, a Debian mirror among its sources, and a network"

_OPTION = re.compile(r"([\w-]+)=(\S+)")
_ONE_LINE = re.compile(r"deb\s+(?:\[(?P<options>[^]]*)\]\s+)?(?P<uri>\S+)\s+(?P<suite>\S+)\s(.+)")
# Said anew for what is wanted here; the rest (keyring, trust, dates) stays as the machine has it.
_REPLACED = ("types", "uris", "suites", "components", "enabled", "targets", "snapshot")
_PER_MACHINE = ("arch", "lang")

_CONFIG = """\
{included}
// The machine's hooks would clean and report the system's folders.
#clear APT::Update;
#clear APT::Architectures;
#clear DPkg;
Dir::Etc::main "/dev/null";
Dir::Etc::parts "/dev/null";
Dir::Etc::preferences "/dev/null";
Dir::Etc::preferencesparts "/dev/null";
Dir::Etc::sourcelist "{apt}/debian.sources";
Dir::Etc::sourceparts "/dev/null";
Dir::State "{apt}/state";
Dir::State::status "{apt}/status";
Dir::Cache "{apt}/cache";
Dir::Log "{apt}/log";
APT::Architectures {{ "{native}"; "armhf"; }};
// The user that apt steps down to can't look into another's cache folder.
APT::Sandbox::User "root";
Acquire::Retries "1";
Acquire::http::Timeout "20";
Acquire::https::Timeout "20";
"""

_WORD = "import sys; print(sys.implementation.name, sys.maxsize)"


def command() -> list[str]:
    """The command line that runs the 32-bit MicroPython; sets it up on first use.

    SolenavError, with the reason, where it can't be had.
    """
    if not sys.platform.startswith("linux"):
        raise _unavailable("it needs Linux")
    folder = cache_folder().absolute() / "micropython32"
    root = folder / CODENAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _alone(folder):
            if not (root.is_dir() and _emulator(root)):
                _set_up(folder, root)
    except (OSError, tarfile.TarError) as error:
        raise _unavailable(str(error)) from None
    return _command(root)


def main() -> int:
    """Print the command line; where there is none, the reason on stderr, and return 1."""
    try:
        print(shlex.join(command()))
    except SolenavError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return 1
    return 0


def _unavailable(reason: str) -> SolenavError:
    return SolenavError(f"no 32-bit MicroPython here: {reason}", _REMEDY)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One process at a time: tests run in several."""
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _emulator(root: Path) -> str | None:
    own = root / "qemu-arm"
    if own.is_file():
        return str(own)
    return shutil.which("qemu-arm") or shutil.which("qemu-arm-static")


def _command(root: Path) -> list[str]:
    # MicroPython's heap then comes from below 2**30, where a microcontroller's memory is. Viper
    # passes pointers as ints; from higher up, each would be a new object on the heap.
    low = "GLIBC_TUNABLES=glibc.malloc.mmap_threshold=0x3fffffff"
    interpreter = root / "usr" / "bin" / "micropython"
    return [str(_emulator(root)), "-E", low, "-L", str(root), str(interpreter)]


def _set_up(folder: Path, root: Path) -> None:
    for tool in ("apt-get", "dpkg", "dpkg-deb"):
        if not shutil.which(tool):
            raise _unavailable(f"{tool} is not installed")
    apt = folder / "apt"
    new = folder / "new"
    try:
        _download(apt)
        shutil.rmtree(new, ignore_errors=True)
        _extract(apt, new)
        if _run(apt, *_command(new), "-c", _WORD).split() != ["micropython", str(2**31 - 1)]:
            raise _unavailable("what the mirror has is no 32-bit MicroPython")
        shutil.rmtree(root, ignore_errors=True)
        # In one step, so that a folder of the final name is complete.
        new.rename(root)
    finally:
        for left in (apt, new):
            shutil.rmtree(left, ignore_errors=True)


def _download(apt: Path) -> None:
    """The packages into `apt`, from the first source and suite that has them all."""
    reasons = []
    for entry in debian_entries(_ETC):
        for suite in SUITES:
            try:
                _prepare(apt, entry, suite)
                _run(apt, "apt-get", "update", "--error-on=any")
                _need_codename(apt)
                install = ["install", "-y", "--download-only", "--no-install-recommends"]
                _run(apt, "apt-get", *install, "micropython:armhf")
                if not _emulator(apt):
                    _run(apt, "apt-get", "download", "qemu-user")
                return
            except SolenavError as error:
                reasons.append(error)
    raise reasons[0] if reasons else _unavailable("apt has no Debian mirror among its sources")


def debian_entries(etc: Path) -> Iterator[dict[str, str]]:
    """The entries in apt's folder `etc` for a whole release's `main`, binary packages.

    Of either syntax, as deb822 fields by lower-case name.
    """
    for entry in _entries(etc):
        suites = [
            suite
            for suite in entry.get("suites", "").split()
            if not suite.endswith(("/", "-updates", "-security", "-backports", "-proposed"))
        ]
        components = entry.get("components", "").split()
        off = entry.get("enabled", "yes").lower() in ("no", "false", "0")
        if "deb" in entry.get("types", "").split() and suites and "main" in components and not off:
            yield entry


def _entries(etc: Path) -> Iterator[dict[str, str]]:
    for path in [etc / "sources.list", *sorted((etc / "sources.list.d").glob("*"))]:
        if not path.is_file() or path.suffix not in (".list", ".sources"):
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        yield from _one_lines(text) if path.suffix == ".list" else _stanzas(text)


def _one_lines(text: str) -> Iterator[dict[str, str]]:
    for line in text.splitlines():
        if found := _ONE_LINE.fullmatch(line.partition("#")[0].strip()):
            options = _OPTION.findall(found["options"] or "")
            entry = {name.lower(): value.replace(",", " ") for name, value in options}
            entry |= {"types": "deb", "uris": found["uri"], "suites": found["suite"]}
            yield entry | {"components": found[4]}


def _stanzas(text: str) -> Iterator[dict[str, str]]:
    kept = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    for stanza in re.split(r"\n\s*\n", kept):
        entry = {}
        # A field goes on over lines that begin with a space; a keyring may be such a field.
        for field in re.split(r"\n(?=\S)", stanza.strip("\n")):
            name, _, value = field.partition(":")
            entry[name.strip().lower()] = value.strip(" \t")
        yield entry


def _prepare(apt: Path, entry: Mapping[str, str], suite: str) -> None:
    """An apt of its own in `apt`, with the one source `entry` at `suite`."""
    shutil.rmtree(apt, ignore_errors=True)
    for name in ("state/lists/partial", "cache/archives/partial", "log"):
        (apt / name).mkdir(parents=True)
    (apt / "status").touch()
    fields = {
        name: value
        for name, value in entry.items()
        if name not in _REPLACED and not name.startswith(_PER_MACHINE)
    }
    fields |= {"types": "deb", "uris": entry["uris"], "suites": suite, "components": "main"}
    fields["targets"] = "Packages"
    source = "".join(f"{name}: {value}\n" for name, value in fields.items())
    (apt / "debian.sources").write_text(source, encoding="utf-8")
    # The machine's proxies and checks.
    parts = [f"{_ETC}/apt.conf.d/", f"{_ETC}/apt.conf"]
    included = "\n".join(f'#include "{part}";' for part in parts if Path(part).exists())
    native = _run(apt, "dpkg", "--print-architecture").strip()
    config = _CONFIG.format(included=included, apt=apt, native=native)
    (apt / "apt.conf").write_text(config, encoding="utf-8")


def _need_codename(apt: Path) -> None:
    form = ["--format", "$(CODENAME)", "Created-By: Packages"]
    found = set(_run(apt, "apt-get", "indextargets", *form).split())
    if found != {CODENAME}:
        raise _unavailable(f"the mirror has {', '.join(sorted(found))}, not {CODENAME}")


def _extract(apt: Path, new: Path) -> None:
    """Unpack what was downloaded; of the emulators only the one."""
    (new / "usr" / "lib").mkdir(parents=True)
    # The binary names its loader by the path from before /lib became a link.
    (new / "lib").symlink_to("usr/lib")
    for package in sorted((apt / "cache" / "archives").glob("*.deb")):
        _run(apt, "dpkg-deb", "-x", str(package), str(new))
    for package in apt.glob("qemu-user_*.deb"):
        # As a stream: all its emulators together would take half a gigabyte.
        listing = ["dpkg-deb", "--fsys-tarfile", str(package)]
        with (
            subprocess.Popen(listing, stdout=subprocess.PIPE) as unpacking,
            tarfile.open(fileobj=unpacking.stdout, mode="r|") as archive,
        ):
            for member in archive:
                if member.name != "./usr/bin/qemu-arm":
                    continue
                file = archive.extractfile(member)
                if file:
                    with (new / "qemu-arm").open("wb") as target:
                        shutil.copyfileobj(file, target)
                    (new / "qemu-arm").chmod(0o755)


def _run(apt: Path, *arguments: str) -> str:
    """A program's stdout; SolenavError with its first complaint where it fails."""
    program = Path(arguments[0]).name
    environment = {**os.environ, "APT_CONFIG": str(apt / "apt.conf"), "LC_ALL": "C.UTF-8"}
    try:
        done = subprocess.run(
            arguments,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT,
            check=False,
            cwd=apt,
            env=environment,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _unavailable(f"{program}: {error}") from None
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        errors = [line for line in lines if line.startswith("E:")]
        raise _unavailable(f"{program}: {(errors or lines or ['it failed'])[0]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
