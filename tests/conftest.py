"""Machines are noisy: no property is timed, nor what its first example makes."""

import pytest
from hypothesis import settings

# "make fuzz" tries more.
settings.register_profile("untimed", deadline=None, max_examples=25)
settings.load_profile("untimed")

# These share diagnoses, so that one worker runs them; it runs any other file as well.
_DIAGNOSED = {
    "test_advise", "test_benchmark", "test_diagnose", "test_diagnosis_report",
    "test_explanations", "test_fixed", "test_menu", "test_viewers",
}  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        file = item.path.stem
        group = "diagnosed" if file in _DIAGNOSED else file
        item.add_marker(pytest.mark.xdist_group(group))
