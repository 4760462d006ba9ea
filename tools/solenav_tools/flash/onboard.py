# ruff: noqa
"""What `solenav flash` runs on the board: sent as text over the REPL, names begin with `fl_`.

The watchdog of a firmware that was interrupted can't be stopped, so it is fed at each call. It is
armed even where it wasn't: a board whose cable is pulled restarts by itself 8.4 s later, into
whichever tree is whole.
"""

import binascii
import gc
import hashlib
import os
import sys

try:
    import machine

    fl_dog = machine.WDT(timeout=8388)
except (ImportError, AttributeError):
    fl_dog = None


# The interrupted firmware's modules and buffers fill the heap.
for fl_name in list(sys.modules):
    if (getattr(sys.modules[fl_name], "__file__", "") or "")[:2] in ("a/", "b/"):
        del sys.modules[fl_name]
gc.collect()


def fl_feed():
    if fl_dog:
        fl_dog.feed()


def fl_folder(path):
    return os.stat(path)[0] & 0x4000 != 0


def fl_exists(path):
    try:
        os.stat(path)
    except OSError:
        return False
    return True


def fl_digest(path):
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while True:
            fl_feed()
            piece = file.read(1024)
            if not piece:
                break
            digest.update(piece)
    return binascii.hexlify(digest.digest()).decode()


def fl_list(path):
    for name in sorted(os.listdir(path)):
        whole = path + "/" + name
        if fl_folder(whole):
            fl_list(whole)
        else:
            print(fl_digest(whole), os.stat(whole)[6], whole)


def fl_make(path):
    at = path.find("/")
    while at > 0:
        if not fl_exists(path[:at]):
            os.mkdir(path[:at])
        at = path.find("/", at + 1)


def fl_put(path, mode, text):
    fl_feed()
    with open(path, mode) as file:
        file.write(binascii.a2b_base64(text))


def fl_copy(source, target):
    with open(source, "rb") as old, open(target, "wb") as new:
        while True:
            fl_feed()
            piece = old.read(1024)
            if not piece:
                break
            new.write(piece)


def fl_remove(path):
    fl_feed()
    if not fl_exists(path):
        return
    if fl_folder(path):
        for name in os.listdir(path):
            fl_remove(path + "/" + name)
        os.rmdir(path)
    else:
        os.remove(path)


def fl_free():
    found = os.statvfs(os.getcwd())
    return found[0] * found[3]


# Lines in boot.py: on FAT there is no main.py between the two halves of a renaming.
fl_GUARD = (
    b"\nimport os  # solenav flash: completes what was cut off\n"
    b"if 'main.py' not in os.listdir() and 'main.py.new' in os.listdir():\n"
    b"    os.rename('main.py.new', 'main.py')\n"
)


def fl_read(path):
    try:
        with open(path, "rb") as file:
            return file.read()
    except OSError:
        return b""


def fl_boot(text):
    with open("boot.py.new", "wb") as file:
        file.write(text)
    os.rename("boot.py.new", "boot.py")


def fl_guard():
    fl_unguard()
    fl_boot(fl_read("boot.py") + fl_GUARD)


def fl_unguard():
    fl_feed()
    if fl_exists("boot.py.new"):
        # Cut off here earlier: whole where boot.py isn't there, but for a torn first one.
        if fl_exists("boot.py") or fl_GUARD.startswith(fl_read("boot.py.new")):
            os.remove("boot.py.new")
        else:
            os.rename("boot.py.new", "boot.py")
    text = fl_read("boot.py")
    if text.endswith(fl_GUARD):
        text = text[: -len(fl_GUARD)]
        if text:
            fl_boot(text)
        else:
            os.remove("boot.py")


def fl_keep(path):
    # Under a name of its own, unless it is there already.
    number = 1
    while True:
        kept = "%s.old%d" % (path, number)
        if not fl_exists(kept):
            fl_copy(path, kept)
        if fl_digest(kept) == fl_digest(path):
            return kept
        number += 1
