import os
import sys
from pathlib import Path

import pytest

# The experiments are not installed. At the end of the path, so that the package under test is the installed one.
sys.path.append(str(Path(__file__).parent.parent))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of third-party instances, named by the environment variable PLR_JAX_DATA."""
    folder = os.environ.get("PLR_JAX_DATA")
    if not folder:
        pytest.skip("third-party instances: set PLR_JAX_DATA to their folder")
    path = Path(folder)
    if not path.is_dir():
        pytest.skip(f"third-party instances: PLR_JAX_DATA={folder} is not a folder")
    return path
