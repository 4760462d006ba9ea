"""Boot: configuration, board, application. A crash is told over the link, then on the REPL."""

import gc
import sys

import solenav_core

# Bytes: frames, and what is thrown away from one collection to the next.
_FRAMES = 8192
_ARRAYS = 22528  # bytes: buffers of the UART, outbox, state, work area, black box


def self_test():
    """Place and name of the first self-test of the core that fails here; (0, "") for none.

    First of all, while the heap is whole; the tests don't stay in it.
    """
    from solenav_core import selftest
    from solenav_core.tables.selftest import EXPECTED

    failed = selftest.first_failure(EXPECTED)
    name = selftest.TESTS[failed - 1][0] if failed else ""
    for module in ("selftest", "tables.selftest", "tables.forest", "tables.lookup"):
        del sys.modules["solenav_core." + module]
    tables = solenav_core.tables
    del solenav_core.selftest, tables.selftest, tables.forest, tables.lookup
    # Nor do kernels that were expanded wherever they were called (solenav.engines.device_form).
    for module in sys.modules.values():
        for spare in getattr(module, "EXPANDED", ()):
            delattr(module, spare)
    return failed, name


def main():
    # MicroPython keeps the frame of a call with many locals on the heap, and looks for room from
    # the heap's start on. So the start is left free: past all that is loaded it would take longer
    # to find room for a frame than to compute a tick.
    # What compiling this file has left behind lies there now.
    gc.collect()
    start = bytearray(_FRAMES)
    __import__("solenav_core.selftest")  # and with it the whole core

    # What importing leaves behind is collected before it tears the heap apart.
    gc.collect()
    # What is loaded leaves holes, none of which holds the application's arrays.
    arrays = bytearray(_ARRAYS)
    failed_test = self_test()
    gc.collect()
    gc.threshold(24576)
    import config

    # The tables are made of more than stays: now there is room for that.
    settings, params, tables, problems = config.load()
    from application import Application

    __import__(settings["board"])
    gc.threshold(-1)
    del arrays
    gc.collect()
    board = sys.modules[settings["board"]].open()
    application = Application(board, settings, params, tables, problems, failed_test)
    del start
    gc.collect()
    try:
        application.run()
    except Exception as error:
        application.log(2, "%s: %s" % (type(error).__name__, error))
        # Whoever wears the board can't start it again: the watchdog does, in 8 s.
        application.watchdog.arm()
        raise
    finally:
        application.blackbox.close()
        application.link.flush()


if __name__ == "__main__":
    main()
