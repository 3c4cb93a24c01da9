"""Site of the manual, the gallery and the API; `make site` builds it without a network."""

import importlib.metadata
from importlib import import_module
from pathlib import Path

HERE = Path(__file__).parent
PACKAGES = (
    "", "recordings", "calibration", "evaluation", "runtime", "filters", "estimators", "features",
    "tip", "export", "monitor", "motion", "crtk", "simulation", "robots", "studies",
)  # fmt: skip

project = "truejoint"
copyright = "the truejoint developers"  # noqa: A001  # Sphinx's name
version = release = importlib.metadata.version("truejoint")
extensions = ["myst_parser", "numpydoc", "sphinx.ext.autosummary", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["gallery/*.ipynb", "results/page.md", "static", "templates"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
root_doc = "index"
templates_path = ["templates"]

myst_heading_anchors = 4
autosummary_generate = True
autodoc_typehints = "none"  # numpydoc has them in words, with shape and unit
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

html_theme = "pydata_sphinx_theme"
html_title = f"truejoint {version}"
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {"text": "truejoint"},
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "navbar_end": ["versions", "theme-switcher", "navbar-icon-links"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_show_sourcelink = False
html_static_path = ["static"]
html_css_files = ["manual.css"]
html_sidebars = {"install": [], "first_steps": []}  # which have no section to list
highlight_language = "none"  # of what a command prints

sphinx_gallery_conf = {
    "examples_dirs": str(HERE.parent / "examples" / "gallery"),
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "write_computation_times": False,
    "download_all_examples": False,
    "show_signature": False,
    "remove_config_comments": True,
    "plot_gallery": True,
    "copyfile_regex": r".*\.rst",
}


def write_pages() -> None:
    """Write the pages of the API from what each package exports; the first only lists its names."""
    api = HERE / "api"
    api.mkdir(exist_ok=True)
    for package in PACKAGES:
        name = f"truejoint.{package}".rstrip(".")
        module = import_module(name)
        exported = {each: getattr(module, each) for each in module.__all__}
        names = [
            each
            for each, value in exported.items()
            if not (each.startswith("_") or hasattr(value, "__path__"))
            and not (isinstance(value, type) and value.__name__ != each)  # a name's other name
        ]
        rows = "\n".join(f"   {each}" for each in sorted(names))
        (api / f"{name}.rst").write_text(
            f"{name}\n{'=' * len(name)}\n\n.. currentmodule:: {name}\n\n"
            f".. autosummary::\n{'' if not package else '   :toctree: generated'}\n\n{rows}\n"
        )


write_pages()  # before Sphinx looks for pages
