"""Write the sources of the site into a folder; unchanged files keep their time, so that a second build is quick."""

from __future__ import annotations

import inspect
import shutil
from pathlib import Path
from pkgutil import resolve_name

from builder.listings import command_page, file_page, output_page, parameter_page, with_members
from builder.pages import Staging, public_names, shown_file

SPHINX_FOLDERS = ("api", "examples")
"""Folders that Sphinx fills."""


def defining_file(name: str) -> str:
    """Return the file that defines the function, class, method or property of this dotted name."""
    return inspect.getsourcefile(inspect.unwrap(resolve_name(name))) or ""


def stage(root: Path, out: Path) -> None:
    """Write all pages, figures and shown files below ``out``; remove those of an earlier build."""
    staging = Staging(root)
    texts = {page: staging.text(source) for source, page in staging.pages.items()}
    texts |= dict(staging.sections())
    texts |= {"parameters.md": parameter_page(), "outputs.md": output_page(), "commands.md": command_page()}
    described = public_names((root / "docs" / "reference.md").read_text())
    staging.files |= {str(Path(defining_file(name)).relative_to(root)) for name in described}
    for path in sorted(with_members(root, staging.files)):
        texts[f"{shown_file(path)}.md"] = file_page(root, path)
    for page, text in texts.items():
        write_if_changed(out / page, text.encode())
    for path in staging.copied:
        write_if_changed(out / path, (root / path).read_bytes())
    keep = {out / name for name in (*texts, *staging.copied)}
    for path in out.rglob("*"):
        if path.is_file() and path not in keep and path.relative_to(out).parts[0] not in SPHINX_FOLDERS:
            path.unlink()


def stage_scripts(scripts: Path, out: Path) -> None:
    """Copy the scripts of the gallery into a new folder, which they may write to."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(scripts, out, ignore=shutil.ignore_patterns("__pycache__"))


def write_if_changed(path: Path, content: bytes) -> None:
    """Write a file unless it has this content already."""
    if not path.is_file() or path.read_bytes() != content:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
