"""The loader of all page templates. Each package holds its own templates; all share the parts in this package."""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

PARTS = "stillpoint.scoring.report"  # holds style.html.j2, parts.html.j2 and page.js
_BOKEH_SCRIPTS = ("bokeh.min.js", "bokeh-api.min.js")


def load_template(package: str, name: str) -> Template:
    """Load the template ``name`` of a package. It may include the shared parts; an undefined name in it is an error."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package, "."), PackageLoader(PARTS, ".")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


@cache
def load_bokeh_scripts() -> Markup:
    """Return the script elements of BokehJS, from the installed package."""
    bokeh = resources.files("bokeh") / "server" / "static" / "js"
    texts = [(bokeh / name).read_text(encoding="utf-8") for name in _BOKEH_SCRIPTS]
    return Markup("\n").join(Markup(f"<script>\n{_escape_end(text)}\n</script>") for text in texts)


@cache
def load_page_script() -> Markup:
    """Return the script element for the end of our pages."""
    text = (resources.files(PARTS) / "page.js").read_text(encoding="utf-8")
    return Markup(f"<script>\n{_escape_end(text)}\n</script>")


def embed_json(data: Mapping[str, Any]) -> Markup:
    """Return data for the script, escaped so that nothing in it can end the script element."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _escape_end(script: str) -> str:
    return script.replace("</script", "<\\/script")
