"""`config.json` beside the firmware: what a person may set, checked; and the build's identity."""

import json

import forest_file

from solenav_core.params import NAMES, conflict
from solenav_core.tables.defaults import LARGEST, LEAST, PARAMS

_DEFAULTS = {
    "board": "boards.rp2_pico",
    "params": {},
    "pose_every": 4,
    "send_samples": True,
    "snapshot_s": 10,
    "autostart": True,
    "sampling": "fifo",
    "dlpf": 1,
    "compass": True,
    "blackbox": "stop",
    "blackbox_samples": False,
    "watchdog": True,
    "checkpoint_s": 10,
    "resume": "always",
}
_CHOICES = {
    "sampling": ("fifo", "ready"),
    "dlpf": (1, 2, 3, 4, 5, 6),
    "blackbox": ("off", "stop", "overwrite"),
    "resume": ("always", "watchdog", "never"),
}


def load():
    """(settings, parameters, tables, what is wrong with the files as texts).

    Parameters and tables are `array('i')`, the tables with the board's own forest where it has one.
    """
    problems = []
    settings = dict(_DEFAULTS)
    for key, value in _read("config.json", problems).items():
        if key not in _DEFAULTS:
            problems.append("config.json: there is no key %s" % key)
        elif type(value) is not type(_DEFAULTS[key]):
            problems.append("config.json: %s can't be %r" % (key, value))
        elif key in _CHOICES and value not in _CHOICES[key]:
            problems.append("config.json: %s can't be %r" % (key, value))
        elif type(value) is int and not 0 <= value <= 65535:
            problems.append("config.json: %s = %d is not 0 to 65535" % (key, value))
        else:
            settings[key] = value
    params = _parameters(settings["params"], problems)
    forest = forest_file.load(problems)
    try:
        tables = forest_file.tables(forest)
    except MemoryError:
        problems.append("%s: no room for that forest: the shipped one is used" % forest_file.FILE)
        forest = None
        tables = forest_file.tables(None)
    return settings, params, tables, problems


def build():
    """(hash, version) that the stager wrote; (0, "unversioned") for files copied by hand."""
    # Beside this file, in whichever tree runs; config.json is one for all of them.
    staged = _read(__file__[: __file__.rfind("/") + 1] + "build.json", [])
    return staged.get("hash", 0), staged.get("version", "unversioned")


def _parameters(chosen, problems):
    # A slice is a copy: the table stays as it was generated.
    params = PARAMS[:]
    for name, value in chosen.items():
        if name not in NAMES:
            problems.append("config.json: there is no parameter %s" % name)
        elif type(value) is not int:
            problems.append("config.json: parameter %s can't be %r" % (name, value))
        elif not LEAST[NAMES.index(name)] <= value <= LARGEST[NAMES.index(name)]:
            at = NAMES.index(name)
            # Past them the core's words would wrap, its kernels leave their arrays.
            problems.append(
                "config.json: %s = %d is not %d to %d" % (name, value, LEAST[at], LARGEST[at])
            )
        else:
            params[NAMES.index(name)] = value
    wrong = conflict(params)
    if wrong:
        problems.append("config.json: %s: default parameters used" % wrong[0])
        return PARAMS[:]
    return params


def _read(path, problems):
    """The file's object; {} without a file, or with one that holds something else."""
    try:
        with open(path) as file:
            found = json.load(file)
    except OSError:
        return {}
    except ValueError:
        found = None
    if not isinstance(found, dict):
        problems.append("%s is no JSON object: defaults used" % path)
        return {}
    return found
