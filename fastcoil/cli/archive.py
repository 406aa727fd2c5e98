"""``fastcoil archive``: a finished study in one file."""

from __future__ import annotations

from pathlib import Path

import click

from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say


@click.command()
@click.argument("folder", type=PATH)
@click.option("-o", "--out", type=PATH, metavar="FILE.zip", help="File to write; FOLDER.zip beside it by default.")
def archive(folder: Path, out: Path | None) -> None:
    """Pack the finished study in FOLDER into one file that `fastcoil verify` accepts anywhere.

    It holds the study file, results and traces, the environment that made them, all hashes, and every file that the
    study reads: weather, logs, fitted parameters, code of its own.  Look at the list before you give it away.
    """
    from fastcoil.study.archive.listing import INPUTS
    from fastcoil.study.archive.pack import pack

    packed = pack(folder, out)
    size = sum(entry.size for entry in packed.listing.files.values())
    say(f"Archive: {packed.path} ({size / 1e6:,.1f} MB), content_sha256 {packed.listing.content_sha256}")
    say(*(f"Input:   {name}" for name in packed.listing.files if name.startswith(f"{INPUTS}/")))
    for path, member in packed.listing.elsewhere.items():
        say(f"Note:    the study reads {path}, a path that other machines lack; it is packed as {member}", err=True)
