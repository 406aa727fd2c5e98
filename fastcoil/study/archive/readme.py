"""The README of an archive, for whoever finds it in ten years."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastcoil.base.text import printable
from fastcoil.loops.provenance import ABSENT, PACKAGES
from fastcoil.study.archive.listing import HERE, Listing
from fastcoil.study.folder.folder import STUDY


def readme(name: str, attrs: Mapping[Any, Any], listing: Listing, base: str) -> str:
    """Plain text: what it is, how to check it, read it and compute it again."""
    made = listing.made_with
    packages = made.get("package_versions")
    known = packages if isinstance(packages, dict) else {}
    pinned = " ".join(f"{each}=={known[each]}" for each in PACKAGES if known.get(each, ABSENT) != ABSENT)
    study = f"{name}/{STUDY}" if base == HERE else f"{name}/{base}/{STUDY}"
    lines = [
        printable(str(attrs["title"])),
        "",
        "A study made with fastcoil: the study file, its results, the files that it reads, and their hashes.",
        "",
        f"content_sha256   {listing.content_sha256}",
        f"fastcoil         {made['fastcoil_version']}",
        f"Python           {made['python_version']}",
        f"machine          {made['platform']}",
        f"run on           {made['date_created']}",
        "",
        "Check it, before and after it is unpacked:",
        "",
        f"    fastcoil verify {name}.zip",
        f"    unzip {name}.zip",
        f"    fastcoil verify {name}",
        "",
        "Look at it:",
        "",
        f"    fastcoil report {name}",
        f"    python -c 'import fastcoil as fc; print(fc.open_study(\"{name}\"))'",
        "",
        "Compute it again, with the versions that made it:",
        "",
        f"    python -m pip install fastcoil=={made['fastcoil_version']} {pinned}".rstrip(),
        f"    fastcoil run {study} -o again",
        "",
        "On one kind of processor, content_sha256 is then the same to the last digit.",
        "One scenario alone, with all its traces: fastcoil rerun --help",
    ]
    if listing.elsewhere:
        lines += ["", "The study reads these files by a path of its author's machine.  Before it can be verified, once",
                  "unpacked, or computed again, they must be there:", ""]  # fmt: skip
        lines += [f"    {printable(path)}   from {member}" for path, member in listing.elsewhere.items()]
    lines += ["", "Files:", ""]
    lines += [f"    {entry.sha256}  {member}" for member, entry in listing.files.items()]
    return "\n".join(lines) + "\n"
