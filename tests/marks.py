"""Cases that only ``make studies`` runs."""

import pytest


def studied(*values):
    """Values of a parameter, each with the mark of a study."""
    return [pytest.param(x, marks=pytest.mark.study) for x in values]
