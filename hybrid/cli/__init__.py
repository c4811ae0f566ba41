"""The command line: one verb = one public function. Only this package prints."""

from hybrid.cli.command import main

__all__ = ["main"]
