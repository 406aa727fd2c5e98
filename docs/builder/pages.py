"""The pages as Sphinx reads them, in a separate folder, from the pages as a code host shows them.

The sources are plain Markdown with links to files.  Here links between pages get the names that the pages have on the
site, links to other files of the repository lead to a page that shows the file, and the lists of ``docs/index.md``
become the sections of the site.  ``MOVED`` keeps the addresses of pages that were merged.
"""

from __future__ import annotations

import ast
import posixpath
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from builder.terms import link_terms, terms

PAGES_OUTSIDE_DOCS = {
    "README.md": "overview.md",
    "CHANGELOG.md": "changelog.md",
    "studies/README.md": "answers.md",
    "benchmarks/README.md": "benchmarks.md",
    "benchmarks/RESULTS.md": "benchmark-results.md",
}
"""Pages outside ``docs/``."""
TABLE_PAGES = {
    "fastcoil/model/parameters.toml": "parameters.md",
    "fastcoil/model/outputs.toml": "outputs.md",
    "fastcoil/cli/main.py": "commands.md",
}
"""Files that the reference shows as a table."""
FORMER_PAGES = {
    **dict.fromkeys(("inverse", "conditions", "populations"), "findings/inverse"),
    **dict.fromkeys(("hunting", "limit-cycles"), "findings/hunting"),
    **dict.fromkeys(("remedies", "buffer"), "findings/remedies"),
    **{name: f"findings/{name}" for name in ("learning", "wear", "heating", "numerics", "cost", "paper", "tuning")},
    **dict.fromkeys(("days", "operation"), "years"),
    **dict.fromkeys(("notebooks", "tables"), "python"),
    **dict.fromkeys(("diagnosis", "own-ahu"), "logs"),
    **{"linearise": "explain", "extending": "own-rule", "explore": "first-steps"},
    **{"equations": "model", "decisions": "promises", "trust": "clusters"},
}
"""Former page → page that has its content now; the former address leads there."""
GALLERY = "docs/gallery"
GLOSSARY = "glossary.md"
WITHOUT_TERMS = {"docs/glossary.md", "docs/index.md", "docs/reference.md", "CHANGELOG.md"}
"""Pages without links to the glossary, because they are lists."""
NUMBER_MARKS = re.compile(r"<!-- /?number\b.*?-->", re.DOTALL)
FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(?<=\]\()[^)\s]+(?=\))|(?<=\]: )\S+$", re.MULTILINE)
SECTION = re.compile(r"^## (.+?)\n(.*?)(?=^## |\Z)", re.DOTALL | re.MULTILINE)
LINK_WITH_TITLE = re.compile(r"\[([^\]]+)\]\(([^)]+)\)")
ITEM = re.compile(r"^\* \[([^\]]+)\]\(([^)#\s]+)\)", re.MULTILINE)
CODE_MARK = re.compile(r"^<!-- code ([\w/.]+): ([\w., ]+) -->$", re.MULTILINE)
NAMES = re.compile(r"^(?:`(?:fc|fastcoil)\.[\w.]+`[,\s]*)+$", re.MULTILINE)


def sources(root: Path) -> dict[str, str]:
    """Return page of the site → page of the repository."""
    docs = root / "docs"
    paths = [path.relative_to(docs).as_posix() for path in sorted([*docs.glob("*.md"), *docs.glob("findings/*.md")])]
    pages = {f"docs/{path}": path for path in paths}
    return {repository_page: site_page for site_page, repository_page in (pages | PAGES_OUTSIDE_DOCS).items()}


def redirects() -> dict[str, str]:
    """Return file of the site → HTML that leads from a former address to its new one."""
    page = '<!doctype html>\n<meta charset="utf-8">\n<title>Moved</title>\n'
    page += '<meta http-equiv="refresh" content="0; url={0}">\n<p>This page is now <a href="{0}">{0}</a>.</p>\n'
    return {f"{old}.html": page.format(f"{new}.html") for old, new in FORMER_PAGES.items()}


def outside_fences(text: str, change) -> str:
    """Apply ``change`` to the parts of ``text`` outside fenced blocks."""
    ends = [0, *(edge for fence in FENCE.finditer(text) for edge in fence.span()), len(text)]
    parts = [text[a:b] for a, b in zip(ends, ends[1:], strict=False)]
    return "".join(part if i % 2 else change(part) for i, part in enumerate(parts))


def shown_file(path: str) -> str:
    """Return the page of the site that shows a file or folder of the repository."""
    return f"files/{path}"


def source_of(module: str, name: str) -> str:
    """Return the source of a function of a module, with its decorators."""
    lines = module.splitlines()
    node = next((n for n in ast.parse(module).body if isinstance(n, ast.FunctionDef) and n.name == name), None)
    if node is None:
        raise ValueError(f"no function {name} in the module that begins with {lines[0]}")
    return "\n".join(lines[node.decorator_list[0].lineno - 1 : node.end_lineno])


class Staging:
    """Makes the pages of the site from those below ``root``, and collects the other files that they link to."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.pages = {site_page: repository_page for repository_page, site_page in sources(root).items()}
        self.files: set[str] = set()
        self.copied: set[str] = set()
        self.terms = terms((root / "docs" / GLOSSARY).read_text()) if (root / "docs" / GLOSSARY).is_file() else {}

    def target(self, link: str, page: str) -> str:
        """Return the target of a link of ``page`` on the site."""
        site_path = self._target(link, page)
        if ":" in link or link.startswith("#"):
            return site_path
        return posixpath.relpath(site_path, posixpath.dirname(self.pages.get(page, "")) or ".")

    def _target(self, link: str, page: str) -> str:
        path, mark, anchor = link.partition("#")
        if not path or ":" in link:
            return link
        repository_path = posixpath.normpath(posixpath.join(posixpath.dirname(page), path))
        if repository_path in self.pages:
            return self.pages[repository_path] + mark + anchor
        if page == "docs/reference.md" and repository_path in TABLE_PAGES:
            return TABLE_PAGES[repository_path]
        if repository_path.startswith(GALLERY):
            return f"examples/{Path(repository_path).stem if repository_path != GALLERY else 'index'}.rst"
        if not (self.root / repository_path).exists():
            raise ValueError(f"{page} links to {link}, which does not exist")
        if repository_path.endswith(".png"):
            self.copied.add(repository_path)
            return repository_path
        self.files.add(repository_path)
        if repository_path.endswith(".ipynb"):
            self.copied.add(repository_path)
        return shown_file(repository_path) + ".md"

    def text(self, page: str) -> str:
        """Return a page as the site has it: fences, links, terms and listings replaced."""
        text = NUMBER_MARKS.sub("", (self.root / page).read_text())
        text = text.replace("\n```math\n", "\n```{math}\n")
        text = outside_fences(text, lambda part: LINK.sub(lambda link: self.target(link[0], page), part))
        unlinked_terms = {term: anchor for term, anchor in self.terms.items() if f"{GLOSSARY}#{anchor})" not in text}
        unlinked_terms = {} if page in WITHOUT_TERMS else unlinked_terms
        glossary = posixpath.relpath(GLOSSARY, posixpath.dirname(self.pages[page]) or ".")
        text = outside_fences(text, lambda part: link_terms(part, unlinked_terms, glossary))
        return NAMES.sub(_summaries, CODE_MARK.sub(self._listing, text))

    def _listing(self, marker: re.Match[str]) -> str:
        path, names = marker[1], [name.strip() for name in marker[2].split(",")]
        self.files.add(path)
        return "\n\n".join(f"```python\n{source_of((self.root / path).read_text(), name)}\n```" for name in names)

    def sections(self) -> Iterator[tuple[str, str]]:
        """Yield (page, text) of the front page, of each of its sections that is not a page, and of the reference."""
        front, top = self.text("docs/index.md"), []
        for title, body in SECTION.findall(front):
            if link := LINK_WITH_TITLE.fullmatch(title):
                top.append(link.groups())
            else:
                top.append((title, re.sub(r"\W+", "-", title.lower()).strip("-") + ".md"))
                yield top[-1][1], f"# {title}\n{body}" + _toctree(ITEM.findall(body))
        yield "index.md", front + _toctree(top)
        reference = self.text("docs/reference.md")
        yield "reference.md", reference + _toctree(ITEM.findall(reference))


def _toctree(pages: Iterable[tuple[str, str]]) -> str:
    """Return a hidden toctree of ``pages``, (title, file), in this order."""
    lines = "\n".join(f"{title} <{page.rpartition('.')[0]}>" for title, page in pages)
    return f"\n```{{toctree}}\n:hidden:\n\n{lines}\n```\n"


def public_names(text: str) -> list[str]:
    """Return the dotted names of the functions and classes that a page of reference describes."""
    names_found = (name for names in NAMES.findall(text) for name in re.findall(r"`([\w.]+)`", names))
    return [re.sub(r"^fc\.", "fastcoil.", name) for name in names_found]


def _summaries(names: re.Match[str]) -> str:
    """Return an autosummary table of the named functions and classes."""
    rows = "\n".join(f"   {name}" for name in public_names(names[0]))
    return f"```{{eval-rst}}\n.. autosummary::\n   :toctree: api\n   :nosignatures:\n\n{rows}\n```\n"
