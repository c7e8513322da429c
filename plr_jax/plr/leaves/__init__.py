"""The kinds of functions that leaves of a PLR can hold (leaf models), with their names and codes in files."""

from plr_jax._arrays import shortened
from plr_jax.plr.container import PAIRS_CODE
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.leaves.cone.codec import ConeFiles as ConeFiles
from plr_jax.plr.leaves.cone.codec import read_goals as read_goals
from plr_jax.plr.leaves.cone.codec import write_goals as write_goals
from plr_jax.plr.leaves.cone.family import FamilyTask as FamilyTask
from plr_jax.plr.leaves.cone.family import family_task as family_task
from plr_jax.plr.leaves.cone.model import Cone as Cone
from plr_jax.plr.leaves.cone.model import as_sourced as as_sourced
from plr_jax.plr.leaves.cone.model import goal_of_leaves as goal_of_leaves
from plr_jax.plr.leaves.cone.model import require_goals as require_goals
from plr_jax.plr.leaves.cone.worst_first import WorstFirst as WorstFirst
from plr_jax.plr.leaves.continuous import Continuous
from plr_jax.plr.leaves.continuous import StoredValues as StoredValues
from plr_jax.plr.leaves.continuous import TiedPartition as TiedPartition
from plr_jax.plr.leaves.plane import Plane as Plane

# The index of a model is its code in files, so new models go to the end.
_MODELS: tuple[LeafModel, ...] = (Plane(), Continuous(order=0), Continuous(order=1), Cone())


def leaf_names() -> list[str]:
    return [model.name for model in _MODELS]


def leaf_model(leaf: LeafModel | str) -> LeafModel:
    """Return the leaf model with the name ``leaf``, or ``leaf`` itself if it is a leaf model with a code in files.

    ``ValueError`` for anything else.
    """
    models = {model.name: model for model in _MODELS}
    if isinstance(leaf, str) and leaf in models:
        return models[leaf]
    if isinstance(leaf, LeafModel) and leaf.name in models:  # files store the name's code
        return leaf
    names = ", ".join(map(repr, models))
    expected = f"a leaf model or its name, with construct also 'best', one of {names}"
    raise ValueError(f"leaf must be {expected}, got {shortened(leaf)}.")


def code_of_leaf(leaf: LeafModel) -> int:
    return next(code for code, model in enumerate(_MODELS) if model.name == leaf.name)


def leaf_of_code(code: int) -> LeafModel:
    """Return the leaf model that a code in a file stands for.

    ``ValueError`` if no model has this code; its message begins with "it", for the caller to say which file.
    """
    if code == PAIRS_CODE:
        raise ValueError("it is a file of distances between any two points; read it with load")
    if code >= len(_MODELS):
        raise ValueError(f"it has leaves of kind {code}, this release knows kinds 0 to {len(_MODELS) - 1}")
    return _MODELS[code]
