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
