"""Reports as HTML pages that refer to no other file."""

import jinja2

from drftjax import __version__


def render_page(template: str, **values: object) -> str:
    """A page by one of the templates beside this module; texts are escaped.

    Args:
        template: Name of its file.
        **values: What the template shows.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("diagnose.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(version=__version__, **values)
