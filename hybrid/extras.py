"""Packages that a plain installation leaves out."""

from importlib.util import find_spec

from hybrid.errors import HybridError


def check_extra(library: str, extra: str, purpose: str) -> None:
    """Refuse what needs a package that is not installed.

    The error says which ``extra`` brings the ``library``; ``purpose`` starts its
    sentence.
    """
    if find_spec(library) is None:
        raise HybridError(
            f"{purpose} needs {library}, which is not installed; "
            f"run: pip install 'hybrid-arm[{extra}]'"
        )
