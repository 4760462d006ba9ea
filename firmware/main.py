"""Boot: configuration, board, application. A crash is told over the link, then on the REPL."""

import sys

import config
from application import Application


def main():
    settings, params, problems = config.load()
    __import__(settings["board"])
    board = sys.modules[settings["board"]].open()
    application = Application(board, settings, params, problems)
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
