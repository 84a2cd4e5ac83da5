"""The command ``bcfj``: results to stdout and a folder, progress to stderr, exit codes as documented.

``base`` has the application and what all verbs share, ``options`` the options that several take; each other module has a
group of verbs. Modules import what a verb needs when it runs, so that help is quick and nothing here loads calibration.
"""

from __future__ import annotations

import gc
import importlib
import signal
import sys

from bcfj_jax.cli.base import BAD_INPUT, DONE, INTERRUPTED, SIMULATION_FAILED, app
from bcfj_jax.io.stop import SIGNALLED, end_process, ended, heeded, last, leave
from bcfj_jax.io.streams import be_patient

__all__ = ["BAD_INPUT", "DONE", "INTERRUPTED", "SIMULATION_FAILED", "app", "command", "main"]

# Of Python's collector: objects made between two rounds, and rounds of one generation to one of the next. By default it
# goes 1400 times through what tracing makes, nearly all of which stays: a tenth of a first command's time.
_COLLECTED = (1_000_000, 20, 20)

# A module with verbs has a line here; help lists them in this order.
for _module in ("running", "fitting", "study", "files"):
    importlib.import_module(f"bcfj_jax.cli.{_module}")


def command() -> None:
    """Entry point of the command ``bcfj``: ``main``, and the process ends with it."""
    try:
        main()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            end_process(end.code or DONE)
        raise


def main() -> None:
    """The command ``bcfj``. Ctrl-C is heeded from here on: modules that load may swallow it."""
    be_patient()
    gc.set_threshold(*_COLLECTED)
    try:
        with heeded(signal.SIGTERM):
            try:
                app()
            except SystemExit as end:
                ended()
                if end.code == SIGNALLED + signal.SIGINT:  # So typer has it of every signal that comes before the verb.
                    end.code = SIGNALLED + last()
                leave(end.code if isinstance(end.code, int) else DONE)
                raise
    except KeyboardInterrupt:
        sys.exit(SIGNALLED + last())
