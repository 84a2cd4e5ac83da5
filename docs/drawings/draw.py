"""All drawings of the pages: ``python -m docs.drawings.draw [NAME ...]``, from the repository's root."""

from __future__ import annotations

import sys

import matplotlib

from docs.drawings import curves, flow, gaps, joint
from docs.drawings.base import STYLE

PARTS = {"flow": flow.draw, "joint": joint.draw, "gaps": gaps.draw, "curves": curves.draw}


def main() -> None:
    """Draw them all, or those named; the same drawing gives the same bytes."""
    with matplotlib.rc_context(STYLE):
        for name in sys.argv[1:] or PARTS:
            PARTS[name]()


if __name__ == "__main__":
    main()
