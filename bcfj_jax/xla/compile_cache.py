"""Where compiled programs are kept between processes. Imports nothing that reads the environment before it is set here."""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path

# Size of the machine code that is kept [bytes]; what was used longest ago goes first.
_LIMIT = 2 << 30


def use_cache(folder: str | os.PathLike[str] | None = None) -> None:
    """Keep this process's compiled programs for the next one, as the command ``bcfj`` does. Nothing is kept without.

    Call it right after the import, before anything is simulated.

    Args:
        folder: where; None for ``BCFJ_CACHE``, else the user's cache folder; "off" for nowhere. Workers of a study take
            it over.
    """
    import atexit

    if folder is not None:
        os.environ["BCFJ_CACHE"] = os.fspath(folder)
    open_cache()
    from bcfj_jax.xla.programs import keep_asked

    atexit.register(keep_asked)


def open_cache() -> None:
    """Keep compiled programs between processes: in ``BCFJ_CACHE``, else in the user's cache folder (``off``: nowhere).

    The folder belongs to the user alone (mode 0700) and has a part for every build of jaxlib: JAX trusts what it finds
    there. A folder that is another user's, or cannot be written, is not used, which is said once.
    """
    # JAX keeps no program that calls back to the host, as diffrax's checks do to raise. Here they give NaN instead,
    # which a run reports as its failure. Read when equinox is first imported, so it must be set before.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    # A false alarm of jaxlib 0.10.1 about every program from its cache (jax-ml/jax#38445).
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    from bcfj_jax.xla import programs

    given = os.environ.get("BCFJ_CACHE")
    kept = _folder(given)
    if kept is None:
        return
    own = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if own is None or given:
        jax.config.update("jax_compilation_cache_dir", str(kept / "xla"))
        programs.prune(kept / "xla", _LIMIT)
    # JAX's own threshold of a second would leave out most of these programs.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    programs.Settings.folder = kept / "programs"


def _folder(given: str | None) -> Path | None:
    """The folder of this build of jaxlib, made private; None where nothing can be kept."""
    import importlib.metadata

    import platformdirs

    from bcfj_jax.xla.programs import say_once

    if given == "off":
        return None
    try:
        base = Path(given or platformdirs.user_cache_dir("bcfj-jax"))
        if not (given or base.is_absolute()):  # "~/.cache" of a user without a home.
            raise RuntimeError(f"the user's cache folder {base} has no absolute path")
        folder = base / f"jaxlib-{importlib.metadata.version('jaxlib')}"
        for part in (base, folder, folder / "xla", folder / "programs"):
            _make_private(part)
            about = part.stat()
            others = hasattr(os, "getuid") and about.st_uid != os.getuid()
            # Whoever could write there may have left programs of his own.
            if others or (os.name == "posix" and stat.S_IMODE(about.st_mode) & 0o022):
                why = "belongs to another user" if others else "can be written by other users"
                say_once(f"compiled programs are not kept: {part} {why}; name a folder in BCFJ_CACHE")
                return None
            if stat.S_IMODE(about.st_mode) & 0o055:
                part.chmod(0o700)
            if not os.access(part, os.W_OK | os.X_OK):
                raise PermissionError(13, "no permission to write", str(part))
    except (OSError, RuntimeError) as error:
        why = f"{error.strerror}: {error.filename}" if isinstance(error, OSError) and error.filename else str(error)
        say_once(f"compiled programs are not kept ({why}); name a folder in BCFJ_CACHE, or say BCFJ_CACHE=off")
        return None
    return folder


def _make_private(folder: Path) -> None:
    """Make a folder, and those above it that are missing, for the user alone, whatever the umask is."""
    for part in reversed([folder, *folder.parents]):
        with contextlib.suppress(FileExistsError):
            if not part.exists():
                part.mkdir(mode=0o700)
                part.chmod(0o700)
