"""Check a built site for dead links and for pages that load something from the network.

``python docs/builder/links.py FOLDER`` ends with exit code 1 and a line for each link that does not.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADING_ATTRIBUTES = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""Tag → attribute with the address of what a browser loads without a click."""
STATIC_FOLDER = "_static"
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
        attributes = dict(attrs)
        self.anchors |= {name for name in (attributes.get("id"), attributes.get("name")) if name}
        if tag == "a" and attributes.get("href"):
            self.links.add(attributes["href"] or "")
        address = attributes.get(LOADING_ATTRIBUTES.get(tag, ""))
        if address and attributes.get("rel") != "canonical":
            self.loads.add(address)


def find_problems(folder: Path) -> list[str]:
    """Return a line for each dead link and for each address that is loaded from the network."""
    pages = {
        path.resolve(): Page(path.read_text())
        for path in sorted(folder.rglob("*.html"))
        if STATIC_FOLDER not in path.parts
    }
    lines = []
    for path, page in pages.items():
        name = path.relative_to(folder.resolve())
        outside = {address for address in page.loads if urlsplit(address).netloc}
        lines += [f"{name} loads {address}" for address in sorted(outside)]
        for link in sorted((page.links | page.loads) - outside):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target_path = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target_path.exists():
                lines.append(f"{name} links to {link}, which does not exist")
            elif parts.fragment and target_path in pages and unquote(parts.fragment) not in pages[target_path].anchors:
                lines.append(f"{name} links to {link}: {target_path.name} has no such heading")
    return lines


def check(folder: Path) -> int:
    """Print the problems and return the exit code: 1 if there are any, or if there is no page."""
    lines = find_problems(folder) if any(folder.rglob("*.html")) else [f"{folder} has no pages"]
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(check(Path(sys.argv[1])))
