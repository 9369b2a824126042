"""Sphinx extension of the site: generated pages, links to public names and interactive pages, shared scripts."""

from __future__ import annotations

import hashlib
import shutil
from importlib import resources
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms import SphinxTransform
from sphinx.util.osutil import relative_uri

from scenetruth.html import plotly_script
from scenetruth_site.api import documented_names
from scenetruth_site.generated import fill_in, generated_parts
from scenetruth_site.redirects import write_redirects
from scenetruth_site.search import connect_search, search_words
from scenetruth_site.site_text import site_text

__all__ = ["setup"]

INTERACTIVE = "results/worked_examples/pages"
"""HTML pages that are copied unchanged; the plotly bundle is written to the same directory."""
MATHJAX = "mathjax/tex-svg.js"
"""MathJax with its fonts in one file, below the folder of static files."""


def _fill_in(app: Sphinx, name: str, source: list[str]) -> None:
    source[0] = site_text(Path(app.srcdir), name, source[0])


def _made_anew(app: Sphinx, env: BuildEnvironment, added: set[str], changed: set[str], removed: set[str]) -> list[str]:
    """Return the pages whose generated parts have changed since the last build; Sphinx tracks docstrings itself."""
    before: dict[str, str] = getattr(env, "scenetruth_parts", {})
    now = {}
    for name in sorted(env.found_docs - removed):
        file = Path(app.srcdir, f"{name}.md")
        parts = generated_parts(file.read_text(encoding="utf-8")) if file.is_file() else []
        words = " ".join(search_words().get(name, ()))
        if parts or words:
            made = "".join(fill_in(f"<!-- generated: {part} -->") for part in parts) + words
            now[name] = hashlib.sha256(made.encode()).hexdigest()
    env.scenetruth_parts = now
    return [name for name, digest in now.items() if before.get(name) != digest]


def _public_name(app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, inside: nodes.Element) -> Any:
    """Resolve references by the last part of a name, or by its defining module, to the documented name."""
    if node.get("refdomain") != "py":
        return None
    name = documented_names().get(str(node["reftarget"]).rsplit(".", 1)[-1].rstrip("()"))
    domain: Any = env.domains["py"]
    if name is None or name not in domain.objects or name == node["reftarget"]:
        return None
    found = domain.objects[name]
    return nodes.reference(
        "",
        "",
        inside,
        internal=True,
        refuri=app.builder.get_relative_uri(str(node["refdoc"]), found.docname) + f"#{found.node_id}",
        reftitle=name,
    )


def _name_or_code(
    name: str, rawtext: str, text: str, lineno: int, inliner: Any, options: Any = None, content: Any = ()
) -> tuple[list[nodes.Node], list[nodes.system_message]]:
    """Format text in single backticks as code, with a link if it is a public name."""
    if text.rstrip("()").rsplit(".", 1)[-1] not in documented_names():
        return [nodes.literal(rawtext, text)], []
    reference = addnodes.pending_xref(
        rawtext, refdomain="py", reftype="obj", reftarget=text.rstrip("()"), refexplicit=False, refwarn=False
    )
    reference["refdoc"] = inliner.document.settings.env.docname
    reference += nodes.literal(rawtext, text, classes=["xref", "py"])
    return [reference], []


class InteractivePages(SphinxTransform):  # type: ignore[misc]
    """Link to interactive pages directly instead of offering them as downloads."""

    default_priority = 300

    def apply(self, **kwargs: Any) -> None:
        """Replace links to files below ``results/worked_examples/pages``."""
        for node in list(self.document.findall(addnodes.download_reference)):
            target = Path(self.env.srcdir, self.env.docname).parent.joinpath(str(node["reftarget"]))
            path = Path(self.env.relfn2path(str(node["reftarget"]), self.env.docname)[0]).as_posix()
            if path.startswith(f"{INTERACTIVE}/") and target.is_file():
                uri = relative_uri(f"{self.env.docname}.html", path)
                reference = nodes.reference("", "", *node.children, internal=False, refuri=uri)
                node.replace_self(reference)


def _no_empty_headings(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Replace empty heading cells of tables by data cells."""
    for empty in ('<th class="head"><p></p></th>', "<th></th>"):
        if "body" in context:
            context["body"] = context["body"].replace(empty, "<td></td>")


def _copy_shared(app: Sphinx, failure: Exception | None) -> None:
    """Write the resources shared by the pages, which must not be loaded from other hosts."""
    if failure is not None or app.builder.format != "html":
        return
    script = Path(app.outdir, "_static", MATHJAX)
    script.parent.mkdir(parents=True, exist_ok=True)
    with resources.as_file(resources.files("mathjax") / "static" / "mathjax" / "es5" / "tex-svg.js") as file:
        shutil.copyfile(file, script)
    pages = Path(app.srcdir, INTERACTIVE)
    if not pages.is_dir():
        return
    target = Path(app.outdir, INTERACTIVE)
    shutil.copytree(pages, target, dirs_exist_ok=True)
    (target / "plotly.min.js").write_text(plotly_script(), encoding="utf-8")


def _redirect(app: Sphinx, failure: Exception | None) -> None:
    """Write redirects at the former addresses of pages."""
    if failure is None and app.builder.format == "html":
        write_redirects(Path(app.outdir))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("source-read", _fill_in)
    app.connect("env-get-outdated", _made_anew)
    app.connect("missing-reference", _public_name)
    app.connect("html-page-context", _no_empty_headings)
    connect_search(app)
    app.connect("build-finished", _copy_shared)
    app.connect("build-finished", _redirect, priority=900)
    app.add_role("name_or_code", _name_or_code)
    app.add_transform(InteractivePages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
