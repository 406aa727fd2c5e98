"""How Sphinx builds the site: ``make docs``.

The pages are those of the repository, put in order for the site by ``builder``.  Nothing of the site is loaded from the
internet: equations are MathML, icons and fonts are those of the theme.
"""

import importlib.metadata
import sys
from pathlib import Path
from types import ModuleType

from sphinx.application import Sphinx

import fastcoil

ROOT = Path(__file__).resolve().parents[1]
BUILD_FOLDER = ROOT / "build" / "docs"
sys.path.insert(0, str(ROOT / "docs"))

from builder.pages import redirects, shown_file  # noqa: E402
from builder.stage import defining_file, stage, stage_scripts  # noqa: E402

for (
    name
) in fastcoil.__all__:  # fc.plot is a package of another name: autodoc finds its functions in a module of this one
    if isinstance(thing := getattr(fastcoil, name), ModuleType):
        module = sys.modules[f"fastcoil.{name}"] = ModuleType(f"fastcoil.{name}", thing.__doc__)
        module.__dict__.update({inner: getattr(thing, inner) for inner in thing.__all__})

stage(ROOT, BUILD_FOLDER / "pages")
stage_scripts(ROOT / "docs" / "gallery", BUILD_FOLDER / "scripts")

project = "fastcoil"
author = "The fastcoil authors"
copyright = author
version = release = importlib.metadata.version("fastcoil")
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.linkcode",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "builder.mathml",
]
nitpicky = True
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
templates_path = [str(ROOT / "docs" / "builder" / "templates")]
suppress_warnings = ["config.cache"]

myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]

add_module_names = False
autodoc_typehints = "none"
default_role = "literal"
autodoc_member_order = "bysource"
autosummary_generate = ["reference.md"]
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

sphinx_gallery_conf = {
    "examples_dirs": str(BUILD_FOLDER / "scripts"),
    "gallery_dirs": "examples",
    "filename_pattern": r"\.py",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "image_scrapers": ("matplotlib", "builder.figures.returned_figures"),
    "ignore_repr_types": r"matplotlib\.",
    "show_memory": False,
    "min_reported_time": 5,
    "abort_on_example_error": False,
    "write_computation_times": False,
    "doc_module": ("fastcoil",),
    "backreferences_dir": None,
    "show_signature": False,
}

html_theme = "pydata_sphinx_theme"
html_title = "fastcoil"
html_static_path = [str(ROOT / "docs" / "builder" / "static")]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = html_show_sourcelink = False
html_show_search_summary = False  # pages opened from a disk may not read each other
html_theme_options = {
    "navbar_align": "left",
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "pygments_light_style": "tango",
    "pygments_dark_style": "github-dark",
}


def linkcode_resolve(domain: str, info: dict[str, str]) -> str:
    """Return the page that shows the source of a public function or class; for a method that of its class."""
    outermost = info["fullname"].partition(".")[0]
    path = Path(defining_file(f"{info['module']}.{outermost}")).relative_to(ROOT)
    return f"../{shown_file(str(path))}.html"


def without_signature(
    app: Sphinx, kind: str, name: str, documented: object, options: object, *signature: str
) -> tuple | None:
    """Show no arguments of the classes of results, which are named by their module and which only functions make."""
    return ("", None) if kind == "class" and name.count(".") > 2 else None


def write_redirects(app: Sphinx, exception: Exception | None) -> None:
    """Write a redirect for each former address of a page."""
    for name, text in redirects().items():
        (app.outdir / name).write_text(text)


def setup(app: Sphinx) -> None:
    """Connect the two handlers above."""
    app.connect("build-finished", write_redirects)
    app.connect("autodoc-process-signature", without_signature)
