"""Study files to start from: the template of ``fastcoil init``, and the studies that come with fastcoil."""

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

TEMPLATE = Path(__file__).with_name("template.toml").read_text(encoding="utf-8")


def shipped_studies() -> dict[str, str]:
    """Name → text of the studies that come with fastcoil, by name."""
    folders = (folder for folder in _folder().iterdir() if folder.is_dir())
    found = [file for folder in folders for file in folder.iterdir() if file.name.endswith(".toml")]
    found.sort(key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in found}


def _folder() -> Traversable:
    package = files("fastcoil")
    installed = package / "studies"
    return installed if installed.is_dir() else Path(str(package)).parent / "studies"  # of the repository
