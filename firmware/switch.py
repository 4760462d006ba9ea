"""The board's own `main.py`: picks the tree that `solenav flash` completed last, and runs it.

A flash writes a tree (`a/` or `b/`) beside the one that runs and then renames `active.new` to
`active`, which names the tree: whatever is cut off before leaves the old one, whatever after
the new one. `solenav flash` puts this file at the root.
"""

import os
import sys

_TREES = ("a", "b")


def active():
    """The tree to run; None where there is none."""
    # FAT can't rename onto a file: it removes `active` first, and `active.new` is whole then.
    for name in ("active", "active.new"):
        try:
            with open(name) as file:
                tree = file.read()
        except OSError:
            continue
        if tree in _TREES:
            return tree
    return None


def adopt(tree):
    """A configuration that came with the tree takes its place; one rename, so cut off or done."""
    names = os.listdir()
    if "config.json" not in names and "config.json.new" in names:
        # Cut off between the two halves of a renaming on FAT, so it is whole.
        os.rename("config.json.new", "config.json")
    try:
        os.stat(tree + "/config.json")
    except OSError:
        return
    os.rename(tree + "/config.json", "config.json")


def run():
    tree = active()
    if tree is None:
        print("no firmware here: solenav flash")
        return
    adopt(tree)
    sys.path.insert(0, tree)
    # The tree's own main: this file is __main__.
    import main

    main.main()


if __name__ == "__main__":
    run()
