"""Packages that a plain installation leaves out."""

from importlib.util import find_spec

from hybrid.errors import HybridError


def check_extra(library: str, extra: str, purpose: str) -> None:
    """Refuse what needs a package that is not installed.

    Args:
        library: Name by which Python imports the package.
        extra: Extra of this package that brings it.
        purpose: What needs it, to start a sentence with.

    Raises:
        HybridError: The package is not installed; the line says how to install it.
    """
    if find_spec(library) is None:
        raise HybridError(
            f"{purpose} needs {library}, which is not installed; "
            f"run: pip install 'hybrid-arm[{extra}]'"
        )
