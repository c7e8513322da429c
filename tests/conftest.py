import gc
import os
import sys
from pathlib import Path

import hypothesis
import jaxtyping
import pytest
import shape_checks

# The experiments are not installed. Append, so that the package under test stays the installed one.
sys.path.append(str(Path(__file__).parent.parent))

# One thread per process: xdist already starts several processes, and waiting threads cost more than they save.
# Set before anything imports JAX or NumPy, also for processes that tests start.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

# Workers and the processes that tests start share compiled functions, which are kept between runs.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parent.parent / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

gc.set_threshold(700, 10, 100)  # a tenth of the full collections, which took a twentieth of the time

# CI checks shapes and types, which takes a fifth of the time; see CONTRIBUTING.md.
if shape_checks.IS_ON:
    jaxtyping.install_import_hook("plr_jax", "shape_checks.in_first_calls")

# Examples have no deadline, since a slow machine is not a defect, and are the same in every run.
# `--hypothesis-profile full` tries more of them.
hypothesis.settings.register_profile("quick", deadline=None, derandomize=True, max_examples=20)
hypothesis.settings.register_profile("full", deadline=None, derandomize=True, max_examples=100)
hypothesis.settings.load_profile("quick")

# Files whose tests take seconds each: begun first, so that no worker is left with one of them at the end.
_LONG = ("test_notebooks.py", "test_experiments.py", "test_readme.py", "test_guides.py", "test_solve.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run slow files first, and all other files in their order."""
    items.sort(key=lambda item: not item.path.name.startswith(_LONG))


@pytest.fixture(scope="module", autouse=True)
def _shapes_are_checked_in_first_calls():
    shape_checks.begin_file()


@pytest.fixture
def unchecked_types():
    """Switch the type checks off, so that wrong arguments reach the checks of the library itself."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of third-party instances, named by the environment variable PLR_JAX_DATA."""
    folder = os.environ.get("PLR_JAX_DATA")
    if not folder:
        pytest.skip("third-party instances: set PLR_JAX_DATA to their folder")
    path = Path(folder)
    if not path.is_dir():
        pytest.skip(f"third-party instances: PLR_JAX_DATA={folder} is not a folder")
    return path
