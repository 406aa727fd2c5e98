"""Check a built site for dead links and for pages that load something from the network.

``python docs/builder/links.py FOLDER`` ends with exit code 1 and a line for each link that does not.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""Tag → attribute with the address of what a browser loads without a click."""
STATIC = "_static"
"""Folder of the theme; its pages are templates."""


class Page(HTMLParser):
    """Anchors of a page, its links, and the addresses that it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.loads: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.anchors |= {name for name in (given.get("id"), given.get("name")) if name}
        if tag == "a" and given.get("href"):
            self.links.add(given["href"] or "")
        address = given.get(LOADS.get(tag, ""))
        if address and given.get("rel") != "canonical":
            self.loads.add(address)


def problems(folder: Path) -> list[str]:
    """Return a line for each dead link and for each address that is loaded from the network."""
    pages = {
        path.resolve(): Page(path.read_text()) for path in sorted(folder.rglob("*.html")) if STATIC not in path.parts
    }
    found = []
    for path, page in pages.items():
        name = path.relative_to(folder.resolve())
        outside = {address for address in page.loads if urlsplit(address).netloc}
        found += [f"{name} loads {address}" for address in sorted(outside)]
        for link in sorted((page.links | page.loads) - outside):
            at = urlsplit(link)
            if at.scheme or at.netloc:
                continue
            other = (path.parent / unquote(at.path)).resolve() if at.path else path
            if not other.exists():
                found.append(f"{name} links to {link}, which does not exist")
            elif at.fragment and other in pages and unquote(at.fragment) not in pages[other].anchors:
                found.append(f"{name} links to {link}: {other.name} has no such heading")
    return found


def check(folder: Path) -> int:
    """Print the problems and return the exit code: 1 if there are any, or if there is no page."""
    found = problems(folder) if any(folder.rglob("*.html")) else [f"{folder} has no pages"]
    sys.stdout.write("".join(f"{line}\n" for line in found))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(check(Path(sys.argv[1])))
