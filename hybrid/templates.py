"""Fill the templates of pages and of code in other languages."""

from functools import cache
from pathlib import Path
from typing import Any


def render_template(path: Path, *, markup: bool = False, **content: Any) -> str:
    """Render a template; a name that it uses and ``content`` lacks is an error.

    Args:
        path: File of the template; others of its folder may be included.
        markup: Whether it is markup, in which strings are escaped. In code nothing is:
            names from files must have gone through :mod:`hybrid.names`.
        **content: Values by their names in the template.
    """
    template = _environment(path.parent, markup).get_template(path.name)
    return str(template.render(**content))


@cache
def _environment(folder: Path, markup: bool) -> Any:
    """Templates of a folder; each is compiled once."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # slow to load

    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=markup,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not markup,
    )
    environment.filters["repr"] = repr
    return environment
