import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from page_helpers import run_page
from shape_checks import IS_ON

import plr_jax

MODULES = [plr_jax, *filter(inspect.ismodule, (getattr(plr_jax, name) for name in plr_jax.__all__))]
LIST = Path(__file__).parent / "public_names.txt"
DEPRECATED = list(plr_jax._SUCCESSORS.items())


def test_public_names_are_those_of_the_list():
    """To add or remove a public name, change the list too, and say so in the changelog."""
    found = [f"{module.__name__}.{name}" for module in MODULES for name in sorted(module.__all__)]
    assert LIST.read_text().split() == found
    stated = (LIST.parent.parent / "STABILITY.md").read_text().split("## Version")[0]
    assert {module.__name__.split(".")[-1] for module in MODULES} <= set(re.findall(r"`(\w+)", stated))


@pytest.mark.parametrize(("name", "module"), DEPRECATED)
def test_deprecated_name_warns_and_gives_the_object(name, module):
    with pytest.warns(DeprecationWarning, match=rf"plr_jax\.{name} is now plr_jax\.{module}\.{name}\.") as caught:
        found = getattr(plr_jax, name)
    assert found is getattr(getattr(plr_jax, module), name) and name not in plr_jax.__all__
    assert IS_ON or caught[0].filename == __file__  # checks of shapes wrap functions, so callers are one level higher


@pytest.mark.parametrize("public_module", MODULES, ids=lambda module: module.__name__)
def test_public_names_and_members_have_docstrings(public_module):
    for name in public_module.__all__:
        public = getattr(public_module, name)
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


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_modules_show_only_their_public_names(module):
    assert module.__doc__ and all(getattr(module, name) is not None for name in module.__all__)
    assert sorted(dir(module)) == sorted(module.__all__)


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
