"""``fastcoil explore``: a page to play with one loop, on this machine."""

from __future__ import annotations

import importlib.util
import os
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path

import click

from fastcoil.base.errors import missing_extra
from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.labels import labels_of
from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say

PORT = 5010


@click.command()
@click.argument("target", type=PATH, default="paper_like")
@click.option(
    "--at", multiple=True, metavar="NAME=LABEL", help="The scenario of a sweep: a label for every dimension, day too."
)
@click.option("--port", type=click.IntRange(0, 65535), default=PORT, show_default=True, help="0: any that is free.")
@click.option("--browser/--no-browser", default=True, help="Whether to open the page.")
def explore(target: Path, at: Sequence[str], port: int, browser: bool) -> None:
    """Open a page to play with one loop: move the gap, the tuning, the day, and see at once what it does.

    TARGET is a preset, paper_like by default; a study file; or the folder of a study.  The page is for this machine
    alone, and needs no internet.  Ctrl-C ends it.

    \b
      fastcoil explore
      fastcoil explore lbnl
      fastcoil explore results/study --at backlash=0.07 --at day=3
    """  # noqa: D301 — click reads the backspace
    if importlib.util.find_spec("bokeh") is None:
        raise missing_extra("explore", "bokeh", "explore")
    from fastcoil.deliver.explore.model.model import Model
    from fastcoil.deliver.explore.server import serve
    from fastcoil.loops.presets import PRESETS
    from fastcoil.study.one_scenario import one_scenario

    name, labels = str(target), labels_of(",".join(at))
    given = None if name in PRESETS and not labels else one_scenario(target, labels, {})
    model = Model(given, name) if given is None else Model(given)
    announce_compilation()

    def ready(address: str) -> None:
        say(f"Page: {address}  (this machine only; Ctrl-C ends it)")
        if browser:
            _open(address)

    serve(model, port, ready)
    say("Ended.")


def _open(address: str) -> None:
    """Open the page, if there is a browser that shows it."""
    has_screen = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if has_screen:
        webbrowser.open(address)
