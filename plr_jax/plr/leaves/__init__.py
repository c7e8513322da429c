"""The kinds of functions that leaves of a PLR can hold (leaf models), with their names and codes in files."""

from plr_jax._arrays import require_choice
from plr_jax.plr.container import PAIRS_CODE
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.leaves.cone.codec import ConeFiles, read_goals, write_goals
from plr_jax.plr.leaves.cone.family import FamilyTask, family_task
from plr_jax.plr.leaves.cone.model import Cone, as_sourced, goal_of_leaves, require_goals
from plr_jax.plr.leaves.cone.worst_first import WorstFirst
from plr_jax.plr.leaves.continuous import Continuous, StoredValues, TiedPartition
from plr_jax.plr.leaves.plane import Plane

__all__ = ["Cone", "ConeFiles", "FamilyTask", "Plane", "StoredValues", "TiedPartition", "WorstFirst", "as_sourced"]
__all__ += ["code_of_leaf", "family_task", "goal_of_leaves", "leaf_model", "leaf_names", "leaf_of_code", "read_goals"]
__all__ += ["require_goals", "write_goals"]

# The index of a model is its code in files, so new models go to the end.
_MODELS: tuple[LeafModel, ...] = (Plane(), Continuous(order=0), Continuous(order=1), Cone())


def leaf_names() -> list[str]:
    return [model.name for model in _MODELS]


def leaf_model(leaf: LeafModel | str, *other_names: str) -> LeafModel:
    """Return the leaf model with the name ``leaf``, or ``leaf`` itself if it is a leaf model with a code in files.

    ``ValueError`` for anything else; the message also lists ``other_names``, which the caller takes.
    """
    models = {model.name: model for model in _MODELS}
    require_choice("leaf", leaf.name if isinstance(leaf, LeafModel) else leaf, [*models, *other_names])
    return leaf if isinstance(leaf, LeafModel) else models[leaf]


def code_of_leaf(leaf: LeafModel) -> int:
    return next(code for code, model in enumerate(_MODELS) if model.name == leaf.name)


def leaf_of_code(code: int) -> LeafModel:
    """Return the leaf model that a code in a file stands for.

    ``ValueError`` if no model has this code. Its message begins with "it": the caller puts the name of the file in
    front.
    """
    if code == PAIRS_CODE:
        raise ValueError("it is a file of distances between any two points; read it with load, which needs JAX")
    if code >= len(_MODELS):
        raise ValueError(f"it has leaves of kind {code}, this release knows kinds 0 to {len(_MODELS) - 1}")
    return _MODELS[code]
