"""Are the reports of all verbs free of messages and of findings of axe, offline, on a desktop and on a phone?

    python -m benchmarks.reports.screens --axe node_modules/axe-core/axe.min.js --folder build/reports

makes the report of every verb (those that are there are kept), opens each in headless Chromium without a network at 1280
and 390 px, takes a screenshot of the whole page, and counts console messages, requests, what is wider than the screen, and
findings of axe-core (``npm install axe-core``) with everything unfolded. Needs Chromium, and Tornado of the extra
``cluster`` to speak to it. The exit code is 1 where anything is found.
"""

from __future__ import annotations

import asyncio
import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.common import ROOT, options

WIDTHS = (1280, 390)
LARGEST = 1_000_000  # bytes
# Folder, arguments of bcfj.
VERBS: dict[str, list[str]] = {
    "simulate-impact": ["simulate", "impact"],
    "simulate-bounce": ["simulate", "bounce"],
    "simulate-slider_crank": ["simulate", "slider_crank"],
    "simulate-joint": ["simulate", "joint"],
    "calibrate": ["calibrate", str(ROOT / "examples" / "chung_ooi_fit.toml")],
    "sensitivity-impact": ["sensitivity", "impact", "--wrt", "stiffness,damping,exponent"],
    "sensitivity-joint": ["sensitivity", "joint", "--wrt", "clearance_seat_cage,clearance_head_cage"],
    "study": ["study", "run", "clearance"],
    "tradeoff": ["tradeoff", "impact", "--budget", "120"],
    "design": ["design", "impact", "--minimize", "contact.peak", "--vary", "damping=0.1:1", "--vary", "mass=10g:30g"],
    "reproduce": ["reproduce"],
}
# Wider than the screen, but for what scrolls in a box of its own.
_WIDE = "document.documentElement.scrollWidth > window.innerWidth + 1"
_UNFOLD = "document.querySelectorAll('details').forEach(d => { d.open = true; })"
# Chromium's own, where WebGL has no graphics card: it copies every picture to the page. The pages read no pixels.
_DRIVER = "GPU stall due to ReadPixels"
_FOLD = "document.querySelectorAll('details').forEach(d => { d.open = false; })"
_AXE = (
    "axe.run(document, {resultTypes: ['violations', 'incomplete']}).then(found => found.violations.map(one => "
    "({id: one.id, impact: one.impact, help: one.help, nodes: one.nodes.length, first: one.nodes[0].html.slice(0, 160)})))"
)


class Look(NamedTuple):
    """What was seen of one page at one width."""

    messages: list[str]
    requests: list[str]
    wide: bool
    findings: list[dict[str, Any]]


class Browser:
    """Headless Chromium, spoken to by its DevTools protocol."""

    def __init__(self, program: str):
        self.folder = tempfile.TemporaryDirectory()
        options = [
            "--headless=new",
            "--no-sandbox",
            "--hide-scrollbars",
            "--enable-unsafe-swiftshader",
            "--no-first-run",
        ]
        options += ["--remote-debugging-port=0", f"--user-data-dir={self.folder.name}", "about:blank"]
        self.process = subprocess.Popen([program, *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.number, self.events = 0, []

    async def open(self) -> None:
        """Wait for the browser, and connect to its page."""
        from tornado.httpclient import AsyncHTTPClient
        from tornado.websocket import websocket_connect

        place = Path(self.folder.name) / "DevToolsActivePort"
        for _ in range(300):
            if place.exists() and place.read_text().strip():
                break
            await asyncio.sleep(0.1)
        port = place.read_text().split()[0]
        answer = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json")
        page = next(one for one in json.loads(answer.body) if one["type"] == "page")
        self.socket = await websocket_connect(page["webSocketDebuggerUrl"], max_message_size=1 << 28)
        for domain in ("Page", "Runtime", "Log", "Network"):
            await self.ask(f"{domain}.enable")
        gone = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
        await self.ask("Network.emulateNetworkConditions", **gone)

    async def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command; its answer. Events that come first are kept."""
        self.number += 1
        await self.socket.write_message(json.dumps({"id": self.number, "method": method, "params": params}))
        while True:
            found = await self.next()
            if found.get("id") == self.number:
                if "error" in found:
                    raise RuntimeError(f"{method}: {found['error']}")
                return found["result"]
            self.events.append(found)

    async def next(self) -> dict[str, Any]:
        """The next message of the browser."""
        message = await asyncio.wait_for(self.socket.read_message(), 120)
        if message is None:
            raise RuntimeError("the browser has gone")
        return json.loads(message)

    async def until(self, method: str) -> None:
        """Wait for an event."""
        while not any(one.get("method") == method for one in self.events):
            self.events.append(await self.next())

    async def evaluate(self, code: str) -> Any:
        """The value of an expression in the page."""
        options = {"expression": code, "awaitPromise": True, "returnByValue": True}
        found = await self.ask("Runtime.evaluate", **options)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"])[:500])
        return found["result"].get("value")

    def close(self) -> None:
        """End the browser."""
        self.process.terminate()
        self.process.wait(20)
        self.folder.cleanup()


async def look(browser: Browser, page: Path, width: int, axe: str, picture: Path) -> Look:
    """Open a page at a width, photograph it, and examine it."""
    browser.events.clear()
    phone = width < 600
    await browser.ask(
        "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=2 if phone else 1, mobile=phone
    )
    await browser.ask("Page.navigate", url=page.resolve().as_uri())
    await browser.until("Page.loadEventFired")
    await asyncio.sleep(0.5)
    wide = bool(await browser.evaluate(_WIDE))
    await browser.evaluate(_UNFOLD)
    await asyncio.sleep(1.0)
    wide = wide or bool(await browser.evaluate(_WIDE))
    # Before the photograph, which reads pixels back.
    events = list(browser.events)
    await browser.evaluate(_FOLD)
    await asyncio.sleep(0.5)
    shot = await browser.ask("Page.captureScreenshot", format="png", captureBeyondViewport=True)
    picture.write_bytes(base64.b64decode(shot["data"]))
    await browser.evaluate(_UNFOLD)
    await asyncio.sleep(0.5)
    messages, requests = [], []
    for event in events:
        params = event.get("params", {})
        if event.get("method") == "Runtime.consoleAPICalled":
            messages.append(" ".join(str(a.get("value", a.get("description"))) for a in params["args"]))
        elif event.get("method") == "Runtime.exceptionThrown":
            messages.append(str(params["exceptionDetails"].get("text")))
        elif event.get("method") == "Log.entryAdded" and _DRIVER not in params["entry"]["text"]:
            messages.append(params["entry"]["text"])
        elif event.get("method") == "Network.requestWillBeSent":
            url = params["request"]["url"]
            if not url.startswith(("data:", "blob:")) and url != page.resolve().as_uri():
                requests.append(url)
    await browser.evaluate(axe + "; null")
    return Look(messages, requests, wide, await browser.evaluate(_AXE))


def make(folder: Path, only: list[str]) -> dict[str, Path]:
    """The reports of the verbs, made where they are not there; by name."""
    found = {}
    for name, arguments in VERBS.items():
        if only and name not in only:
            continue
        out = folder / name
        if not (out / "report.html").exists():
            print(f"making {name}", file=sys.stderr, flush=True)
            command = [sys.executable, "-m", "bcfj_jax", *arguments, "--out", str(out)]
            done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
            if not (out / "report.html").exists():
                print(f"{name}: exit code {done.returncode}: {done.stderr[-500:]}", file=sys.stderr)
                continue
        found[name] = out / "report.html"
    return found


async def examine(program: str, pages: dict[str, Path], axe: str, shots: Path) -> bool:
    """Look at every page; print a table, and say whether nothing was found."""
    browser, good = Browser(program), True
    try:
        await browser.open()
        print(
            f"{'report':24} {'kB':>5} {'px':>5} {'messages':>8} {'requests':>8} {'wide':>5} {'serious':>8} {'other':>6}"
        )
        for name, page in pages.items():
            for width in WIDTHS:
                seen = await look(browser, page, width, axe, shots / f"{name}-{width}.png")
                bad = [one for one in seen.findings if one["impact"] in ("serious", "critical")]
                size = page.stat().st_size
                counts = (len(seen.messages), len(seen.requests), seen.wide, len(bad), len(seen.findings) - len(bad))
                print(f"{name:24} {size / 1e3:5.0f} {width:5} {counts[0]:8} {counts[1]:8} {'yes' if counts[2] else '':>5} "
                      f"{counts[3]:8} {counts[4]:6}")  # fmt: skip
                for text in (*seen.messages, *seen.requests, *map(json.dumps, seen.findings)):
                    print(f"    {text[:400]}")
                good = good and not any(counts[:4]) and size <= LARGEST
    finally:
        browser.close()
    return good


def main() -> int:
    """Make the reports, look at them, say what was found."""
    given = options(
        __doc__, folder=(ROOT / "build" / "reports", "where reports and pictures go"),
        axe=(Path("node_modules/axe-core/axe.min.js"), "axe-core's script"), chromium=("chromium", "the browser"),
        only=("", f"of {', '.join(VERBS)}, separated by commas"),
    )  # fmt: skip
    program = shutil.which(given.chromium)
    if program is None or not given.axe.is_file():
        print(f"skipped: there is no {'browser ' + given.chromium if program is None else given.axe}")
        return 0
    given.folder.mkdir(parents=True, exist_ok=True)
    pages = make(given.folder, [name for name in given.only.split(",") if name])
    shots = given.folder / "screens"
    shots.mkdir(exist_ok=True)
    good = asyncio.run(examine(program, pages, given.axe.read_text(encoding="utf-8"), shots))
    print(f"screenshots in {shots}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
