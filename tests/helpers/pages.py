"""HTML pages as in a browser: shown text, loaded files, scripts."""

import base64
from html.parser import HTMLParser
from pathlib import Path

_LOADING_ATTRIBUTES = {"src", "href", "data", "action", "poster", "srcset", "background", "formaction", "xlink:href"}
"""Attributes with the name of another file."""


class Page(HTMLParser):
    """A page, parsed.

    tags: every element.  loads: addresses in attributes and styles.  handlers: attributes that run something.
    text: visible text, with single spaces.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.handlers: list[str] = []
        self.policy = ""
        self._visible_text: list[str] = []
        self._headings: list[str] = []
        self._hidden = 0
        self.feed(self.source)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._hidden += tag in ("style", "script")
        attributes = {name: value or "" for name, value in attrs}
        self.loads += [value for name, value in attributes.items() if name in _LOADING_ATTRIBUTES]
        self.handlers += [name for name in attributes if name.startswith("on")]
        if attributes.get("http-equiv") == "Content-Security-Policy":
            self.policy = attributes["content"]

    def handle_endtag(self, tag: str) -> None:
        self._hidden -= tag in ("style", "script")
        if tag == "style":
            assert "url(" not in self._style
            assert "@import" not in self._style

    def handle_data(self, data: str) -> None:
        if self._hidden:
            self._style = data
        else:
            self._visible_text.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self._visible_text).split())

    @property
    def pictures(self) -> list[bytes]:
        return [base64.b64decode(uri.partition(",")[2]) for uri in self.loads if uri.startswith("data:image/png")]

    def assert_self_contained(self) -> None:
        """Assert that it needs no other file, no network and no script."""
        assert all(uri.startswith("data:image/png;base64,") for uri in self.loads), self.loads
        assert not {"script", "iframe", "object", "embed", "link", "base", "form"} & set(self.tags)
        assert not self.handlers
        assert self.policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
        assert all(picture.startswith(b"\x89PNG") for picture in self.pictures)
