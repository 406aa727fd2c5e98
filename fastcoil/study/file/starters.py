"""Study files to start from: the template of ``fastcoil init``, and the studies that come with fastcoil."""

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

TEMPLATE = Path(__file__).with_name("template.toml").read_text(encoding="utf-8")


def shipped_studies() -> dict[str, str]:
    """Name → text of the studies that come with fastcoil, by name."""
    installed, package = files("fastcoil") / "studies", Path(str(files("fastcoil")))
    home: Traversable = installed if installed.is_dir() else package.parent / "studies"  # of the repository
    found = [file for folder in home.iterdir() if folder.is_dir() for file in folder.iterdir()]
    found = sorted((file for file in found if file.name.endswith(".toml")), key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in found}
