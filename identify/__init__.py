"""Identification: zeta and other numbers of the simulator from recorded runs, `drftjax.fit`.

The distribution `identify`, on which pre-commit depends, has a package of this name too. Installed
beside it, one `__init__.py` replaces the other, so nothing that either needs may stand in it; from
a checkout, the line below lets the other's modules be found as well.
"""

from pkgutil import extend_path

__path__ = extend_path(__path__, __name__)
