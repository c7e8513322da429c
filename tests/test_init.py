import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from page_helpers import run_page

import plr_jax


def test_public_names_and_members_have_docstrings():
    for name in plr_jax.__all__:
        public = getattr(plr_jax, name)
        members = vars(public) if inspect.isclass(public) else {}
        named = {f"{name}.{each}": getattr(public, each) for each in members if not each.startswith(("_", "tree_"))}
        for dotted, value in {name: public, **named}.items():
            if callable(value) or isinstance(value, property):
                assert inspect.getdoc(value) or name == "DistanceFn", dotted


def test_package_docstring_names_guides_and_its_example_runs(tmp_path):
    page = plr_jax.__doc__
    assert {f"plr_jax.guides.{name}" for name in plr_jax.guides.__all__} <= set(re.findall(r"`([\w.]+)`", page))
    run_page(page, tmp_path, is_quick=False)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"plr_jax.*contruct"):
        plr_jax.contruct  # noqa: B018


def test_type_information_is_installed():
    folder = Path(plr_jax.__file__).parent
    assert (folder / "__init__.pyi").exists() and (folder / "py.typed").exists()


@pytest.mark.parametrize("package", [plr_jax, plr_jax.plot, plr_jax.plr, plr_jax.scenes], ids=lambda p: p.__name__)
def test_packages_list_their_public_names(package):
    assert all(getattr(package, name) is not None for name in package.__all__)
    assert set(package.__all__) <= set(dir(package))
    loaded = {name for name, value in vars(package).items() if name[0] != "_" and not isinstance(value, ModuleType)}
    assert loaded <= set(package.__all__)


@pytest.mark.full
def test_loading_and_querying_imports_no_heavy_library(tmp_path):
    path = tmp_path / "cone.plr"
    plr_jax.save(plr_jax.construct(lambda x: abs(x[:, 0]), ([0], [1]), max_leaves=2), path)
    code = f"""
import sys, plr_jax
plr_jax.load({str(path)!r})([[0.5]]).block_until_ready()
assert not {{"scipy.stats", "shapely", "networkx", "matplotlib", "optax", "typer"}} & set(sys.modules)
"""
    environment = {"PYTHONPATH": ":".join(sys.path), "HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
