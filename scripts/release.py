"""Make a release: check, test, build, try, and tag. Nothing is pushed or uploaded.

    python -m scripts.release            every check, the tests of CI, both distributions, then the tag v<version>
    python -m scripts.release --check    the quick checks alone

The version stands in bcfj_jax/_version.py. It is MAJOR.MINOR.PATCH: MAJOR where the outside changes (names, files, commands,
exit codes), MINOR for what is new, PATCH for what is mended. Its tag is ``v`` and the version, annotated with the section
of CHANGELOG.md. A release is a commit on the branch ``main`` whose tree is clean.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def version(text: str) -> str:
    """The version that ``_version.py`` states.

    Raises:
        ValueError: where there is none of the form MAJOR.MINOR.PATCH.
    """
    found = re.search(r'^__version__ = "(\d+\.\d+\.\d+)"$', text, re.MULTILINE)
    if found is None:
        raise ValueError("bcfj_jax/_version.py states no version of the form MAJOR.MINOR.PATCH")
    return found[1]


def section(changelog: str, wanted: str) -> str:
    """The changelog's text about a version, without its heading; empty where there is none."""
    parts = re.split(r"^## +v?(\S+).*$", changelog, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True)).get(wanted, "").strip()


def problems(root: Path, branch: str, changes: str, tags: list[str]) -> list[str]:
    """What stands against a release, in words.

    Args:
        root: the checkout.
        branch: the one that is checked out.
        changes: of the tree, as ``git status --porcelain`` lists them.
        tags: that exist.
    """
    found = []
    try:
        new = version((root / "bcfj_jax" / "_version.py").read_text(encoding="utf-8"))
    except ValueError as error:
        return [str(error)]
    if branch != "main":
        found.append(f"the branch is {branch}: release from main")
    if changes:
        found.append(f"the tree has changes:\n{changes}")
    if f"v{new}" in tags:
        found.append(f"the tag v{new} exists: raise the version in bcfj_jax/_version.py")
    older = [tuple(map(int, tag[1:].split("."))) for tag in tags if re.fullmatch(r"v\d+\.\d+\.\d+", tag)]
    if older and tuple(map(int, new.split("."))) < max(older):
        found.append(f"version {new} is older than the tag v{'.'.join(map(str, max(older)))}")
    if not section((root / "CHANGELOG.md").read_text(encoding="utf-8"), new):
        found.append(f"CHANGELOG.md has no section '## {new}', or an empty one")
    citation = root / "CITATION.cff"
    cited = re.search(r"^version: *[\"']?([^\"'\s]+)", citation.read_text(encoding="utf-8"), re.M)
    if cited is not None and cited[1] != new:
        found.append(f"CITATION.cff cites version {cited[1]}, not {new}")
    return found


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def main(words: list[str]) -> None:
    """Do it; the exit code is 1 where something stands against it."""
    found = problems(
        ROOT, _git("rev-parse", "--abbrev-ref", "HEAD"), _git("status", "--porcelain"), _git("tag", "--list").split()
    )
    if found:
        sys.exit("no release:\n" + "\n".join(f"- {line}" for line in found))
    new = version((ROOT / "bcfj_jax" / "_version.py").read_text(encoding="utf-8"))
    print(f"version {new}: tree, branch, changelog and citation are in order")
    if "--check" in words:
        return
    subprocess.run(["make", "test", "dist-check"], cwd=ROOT, check=True)
    notes = section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), new)
    # Lines of the changelog may begin with '#', which git would take for comments.
    tag = ["git", "tag", "--annotate", f"v{new}", "--cleanup=verbatim", "--message", f"bcfj-jax {new}\n\n{notes}\n"]
    subprocess.run(tag, cwd=ROOT, check=True)
    print(f"tagged v{new}; distributions in build/dist. To publish: git push origin v{new}, then upload build/dist/*")


if __name__ == "__main__":
    main(sys.argv[1:])
