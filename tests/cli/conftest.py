import pytest
from cli_helpers import built


@pytest.fixture(scope="module", params=["plane", "continuous", "smooth"])
def maze(request, tmp_path_factory):
    """A file of each kind."""
    return built(request.param, tmp_path_factory.mktemp("maze"))


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    """A file, where its kind makes no difference."""
    return built("plane", tmp_path_factory.mktemp("plane"))
