"""Reports as HTML pages that refer to no other file and load nothing."""

import base64
import hashlib
from functools import cache
from importlib.resources import files

import jinja2
from markupsafe import Markup

from drftjax import __version__
from drftjax.report_page.run_curves import RunCurves, curve_document


def render_page(
    package: str, template: str, curves: RunCurves | None = None, **values: object
) -> str:
    """A page by a template of a package; every value is text and is escaped.

    The page's content security policy lets nothing be loaded and no script be run but those
    written here, which it names by their hashes.

    Args:
        package: Name of the package whose folder `templates` holds the template.
        template: Name of its file, which extends page.html beside this module.
        curves: Recorded and simulated curves of its runs, for the figure with a run picker.
        **values: Further values of the template.
    """
    own = jinja2.PackageLoader("drftjax.report_page")
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package), own]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    drawn = None if curves is None else curve_document(curves)
    scripts = [] if drawn is None else [_file("uplot/uPlot.iife.min.js"), _file("curves.js")]
    styles = (
        [_file("page.css")] if drawn is None else [_file("uplot/uPlot.min.css"), _file("page.css")]
    )
    return environment.get_template(template).render(
        version=__version__,
        styles=[*styles, _file("page.css")],
        scripts=scripts,
        hashes=[_hash(each) for each in scripts],
        licence=_file("uplot/LICENSE") if scripts else None,
        curves=drawn,
        **values,
    )


@cache
def _file(name: str) -> Markup:
    """Text of a file of this package's own, which is put into a page as it stands."""
    text = files("drftjax.report_page").joinpath("templates", name).read_text("utf-8")
    return Markup(text.strip())


def _hash(script: str) -> str:
    """A script's hash, as a content security policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
