"""Pages as parsed HTML and as rendered by Chromium."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

from tirefit.report.canvas import Picture

PHONE = 390
"""Pixels of the page that a phone shows."""


def without_pictures(make):
    """What ``make()`` writes, without its pictures, which take most of its time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Picture, "_repr_png_", lambda self: b"")
        return make()


def drawn_texts(picture):
    """(text, extent in pixels) of every text in a figure."""
    picture.draw_without_rendering()
    ticks = [
        tick.label1
        for axes in picture.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in axis._update_ticks()  # those within the limits
    ]
    written = [*picture.texts, *(t for a in picture.axes for t in a.texts), *ticks]
    shown = [t for t in written if t.get_text() and t.get_visible()]
    return [(t.get_text(), t.get_window_extent()) for t in shown]


def overlapping(texts):
    return [
        (one, other)
        for i, (one, a) in enumerate(texts)
        for other, b in texts[:i]
        if a.x0 < b.x1 and b.x0 < a.x1 and a.y0 < b.y1 and b.y0 < a.y1
    ]


class Page(HTMLParser):
    """Balance of tags, external resources, and texts of a page."""

    VOID = {"meta", "img", "br"}

    def __init__(self, text):
        super().__init__()
        self.open, self.links, self.seen, self.texts = [], [], [], []
        self.alternatives = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.seen.append(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attributes:
            if name in ("src", "href", "srcset", "action", "data", "poster"):
                self.links.append(value)
            if name == "alt":
                self.alternatives.append(value)
            assert not name.startswith("on")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


BROWSER = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome", "chrome")
        if (found := shutil.which(name))
    ),
    None,
)
in_browser = pytest.mark.skipif(
    BROWSER is None, reason="needs Chromium: neither chromium nor google-chrome found"
)


def browse(page, folder, *options):
    """Chromium's result for a page (a file or an address of this machine), and every request
    that the page made."""
    log = folder / "net.json"
    done = subprocess.run(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
            "--disable-background-networking", "--disable-component-update",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", f"--log-net-log={log}",
            f"--user-data-dir={folder / 'profile'}", "--window-size=1200,900", *options,
            page if isinstance(page, str) else page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    record = json.loads(log.read_text())
    start = record["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"]
    asked = [e.get("params", {}) for e in record["events"] if e["type"] == start]
    # What the browser asks for by itself has no origin.
    mine = [a for a in asked if a.get("initiator", "not an origin") != "not an origin"]
    return done.stdout, [a["url"] for a in mine]


def width_on_phone(text: str, folder) -> int:
    """Width in pixels of a page on a phone."""
    page = folder / "on_phone.html"
    policy = r'<meta http-equiv="Content-Security-Policy"[^>]*>'
    text = re.sub(policy, "", text)
    script = "<script>document.title = document.body.scrollWidth</script>"
    text = text.replace("<html", f'<html style="width:{PHONE}px"')
    page.write_text(text.replace("</body>", f"{script}</body>"))
    document, _ = browse(page, folder, "--dump-dom")
    return int(re.search(r"<title>(\d+)", document)[1])
