"""How Sphinx builds the site: ``make docs``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

from scenetruth import __version__  # noqa: E402

project = "scenetruth"
author = "The scenetruth developers"
copyright = author
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "notfound.extension",
    "scenetruth_site.extension",
]
exclude_patterns = ["_*", "**/.ipynb_checkpoints", "results/worked_examples/pages"]
templates_path = ["_templates"]
language = "en"

# Every link must lead somewhere. Types of other libraries have no pages here: nothing is looked up on a network.
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!scenetruth\.).*"), ("py:.*", r"scenetruth\..*")]
suppress_warnings = ["toc.empty_glob"]

# Pages
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
mathjax_path = "mathjax/tex-svg.js"
mathjax3_config = {"options": {"enableAssistiveMml": True}}

# Notebooks run when they, or what they are made of, have changed.
nb_execution_mode = os.environ.get("SCENETRUTH_SITE_NOTEBOOKS", "cache")
nb_execution_cache_path = str(HERE.parent / "outputs" / "site_cache" / "notebooks")
nb_execution_timeout = 600
nb_execution_raise_on_error = True
# Kernels of this build talk within this machine: they need not warn that others could listen. Pictures are sharp on
# screens with small pixels.
profile = HERE.parent / "outputs" / "site_cache" / "ipython" / "profile_default"
profile.mkdir(parents=True, exist_ok=True)
kernel = 'c.IPKernelApp.log_level = 40\nc.InlineBackend.figure_formats = {"retina"}\n'
(profile / "ipython_kernel_config.py").write_text(kernel, encoding="utf-8")
os.environ["IPYTHONDIR"] = str(profile.parent)

# Reference
autosummary_generate = False
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = True
default_role = "name_or_code"
add_module_names = False
toc_object_entries = False

# Looks
html_theme = "pydata_sphinx_theme"
html_title = "scenetruth"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_context = {"default_mode": "auto"}
html_search_scorer = str(HERE / "_ext" / "scenetruth_site" / "search_ranking.js")
html_copy_source = False
html_show_sourcelink = False
html_sidebars: dict[str, list[str]] = {"index": []}
html_theme_options = {
    "logo": {"text": "scenetruth"},
    "navbar_align": "left",
    "show_toc_level": 2,
    "show_prev_next": True,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
notfound_urls_prefix = os.environ.get("SCENETRUTH_SITE_PREFIX", "/")
notfound_context = {
    "title": "Page not found",
    "body": f"""<h1>Page not found</h1>
<p>This address has no page. It may have moved: search for its topic.</p>
<form action="{notfound_urls_prefix}search.html" method="get" role="search">
<p><label for="missing-page-search">Search the documentation</label>
<input class="form-control" type="search" id="missing-page-search" name="q" placeholder="baseline_mm, RMSE, own camera">
<button class="btn btn-primary mt-2" type="submit">Search</button></p>
</form>
<p>Or begin with <a href="{notfound_urls_prefix}get_started.html">Get started</a>,
the <a href="{notfound_urls_prefix}tutorials/index.html">tutorials</a>,
the <a href="{notfound_urls_prefix}how_to/index.html">how-to guides</a>
or the <a href="{notfound_urls_prefix}index.html">first page</a>.</p>""",
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
