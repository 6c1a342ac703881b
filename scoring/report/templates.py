"""The one loader of all page templates: each package holds its own, and all share the parts in this package."""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

PARTS = "stillpoint.scoring.report"  # holds style.html.j2, parts.html.j2 and page.js
BOKEH_SCRIPTS = ("bokeh.min.js", "bokeh-api.min.js")


def load_template(package: str, name: str) -> Template:
    """The template ``name`` of a package. It may include the shared parts, and nothing in it may be undefined."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package, "."), PackageLoader(PARTS, ".")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


@cache
def bokeh_scripts() -> Markup:
    """BokehJS as it is installed, ready to stand in a page."""
    bokeh = resources.files("bokeh") / "server" / "static" / "js"
    texts = [(bokeh / name).read_text(encoding="utf-8") for name in BOKEH_SCRIPTS]
    return Markup("\n").join(Markup(f"<script>\n{_closed(text)}\n</script>") for text in texts)


@cache
def page_script() -> Markup:
    """The script of our pages, which runs when the page is there."""
    text = (resources.files(PARTS) / "page.js").read_text(encoding="utf-8")
    return Markup(f"<script>\n{_closed(text)}\n</script>")


def embed_json(data: Mapping[str, Any]) -> Markup:
    """Data for the script, so written that nothing in it can end the element it stands in."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _closed(script: str) -> str:
    return script.replace("</script", "<\\/script")
