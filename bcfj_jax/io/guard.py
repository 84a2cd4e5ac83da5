"""What a command says when it cannot go on: a sentence in place of a traceback, and the exit code that belongs to it."""

from __future__ import annotations

import errno
import traceback
from collections.abc import Callable

from bcfj_jax.core.errors import InputError, escaped
from bcfj_jax.io import stop
from bcfj_jax.io.folder import Session, session

BAD_INPUT, INTERRUPTED = 2, 5
_SPACE = (errno.ENOSPC, errno.EDQUOT)


def guarded(verb: Callable[[], int], say: Callable[[str], None]) -> int:
    """Run a verb; its exit code: 2 for bad input and what the system refuses, 5 where finished work was kept.

    Ctrl-C and SIGTERM end with 5 where work was kept, else with 130 or 143; the folder is as it was, or has a result's stage.
    """
    held = Session()
    try:
        with session() as held:
            return verb()
    except InputError as error:
        say(f"error: {escaped(str(error))}")
        return BAD_INPUT
    except KeyboardInterrupt:
        if not held.kept:
            stays = f"what there was stays in {held.stages[-1]}" if held.stages else "nothing was kept"
            say(f"interrupted; {stays}: start again")
            return stop.SIGNALLED + stop.last()
        say("interrupted")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        remedy = "free some space" if error.errno in _SPACE else "check the folder and its permissions"
        say(f"error: {escaped(f'{where}{error.strerror or error}; {remedy}')}")
    except MemoryError:
        say("error: not enough memory; ask for fewer samples, points or starts")
    except RecursionError as error:
        frames = traceback.extract_tb(error.__traceback__, limit=-1)
        place = frames[-1].name if frames else "unknown"
        say(f"error: something is nested too deeply ({place}); write it flatter")
    except RuntimeError as error:
        # XLA's own class for it; there is no common one.
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        say("error: not enough memory for this run; ask for fewer samples, points or starts")
    if not held.kept:
        return BAD_INPUT
    say(f"finished work is kept in {held.kept[0]}: the same command with --out {held.kept[0]} goes on")
    return INTERRUPTED
