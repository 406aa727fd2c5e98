"""Writes the sources of the site into a folder; what has not changed is left alone, so that a second build is quick."""

from __future__ import annotations

import inspect
import shutil
from pathlib import Path
from pkgutil import resolve_name

from builder.listings import command_page, file_page, output_page, parameter_page, with_members
from builder.pages import Staging, public, shown_file

MADE = ("api", "examples")
"""Folders that Sphinx fills."""


def home(name: str) -> str:
    """File that defines a function, class, method or property, given by its dotted name."""
    return inspect.getsourcefile(inspect.unwrap(resolve_name(name))) or ""


def stage(root: Path, out: Path) -> None:
    """All pages, figures and shown files below ``out``; what is there of an earlier build goes."""
    staging = Staging(root)
    texts = {page: staging.text(source) for source, page in staging.pages.items()}
    texts |= dict(staging.sections())
    texts |= {"parameters.md": parameter_page(), "outputs.md": output_page(), "commands.md": command_page()}
    described = public((root / "docs" / "reference.md").read_text())
    staging.files |= {str(Path(home(name)).relative_to(root)) for name in described}
    for path in sorted(with_members(root, staging.files)):
        texts[f"{shown_file(path)}.md"] = file_page(root, path)
    for page, text in texts.items():
        written(out / page, text.encode())
    for path in staging.copied:
        written(out / path, (root / path).read_bytes())
    keep = {out / name for name in (*texts, *staging.copied)}
    for path in out.rglob("*"):
        if path.is_file() and path not in keep and path.relative_to(out).parts[0] not in MADE:
            path.unlink()


def stage_scripts(scripts: Path, out: Path) -> None:
    """The scripts of the gallery in a folder that they may write to, without what they wrote there last time."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(scripts, out, ignore=shutil.ignore_patterns("__pycache__"))


def written(path: Path, content: bytes) -> None:
    """Writes a file unless it is there already."""
    if not path.is_file() or path.read_bytes() != content:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
