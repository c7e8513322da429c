"""CAMAR's discs as polygons: the distance of each agent to its goal, inside CAMAR's compiled step.

Agents are points among polygons around the discs, which are as much larger as an agent's radius. Corners of the map
are found once a level, in ``reset``, or again in every step, as if discs moved: a shift that rounds to nothing keeps
the compiler from finding them once. CAMAR closes its borders by discs;
here bounds stand for them.
"""

import importlib
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.differentiating._common import compiled, least
from plr_jax import VisibilityGraph, Workspace, polygon_distance
from plr_jax.traced import polygons_of_discs

OBSTACLES = (1, 2, 4)  # of 8 discs each
CORNERS = 8  # of the polygon around a disc
AGENTS, STEPS, LEVELS = 32, 100, 16
_CHECKED = 2  # levels whose distances are compared with the oracle's
ALLOWED = 1e-5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    try:
        camar = importlib.import_module("camar")
    except ImportError as error:
        print(f"camar: left out, {error}")
        return {"camar": "not installed", "rows": []}
    sizes = OBSTACLES[:1] if smoke else OBSTACLES
    return {
        "camar": version("camar"),
        "agents": 4 if smoke else AGENTS,
        "levels": 2 if smoke else LEVELS,
        "steps": 2 if smoke else STEPS,
        "corners of a disc": CORNERS,
        "rows": [_row(camar, obstacles, seed, smoke) for obstacles in sizes],
    }


def _row(camar: Any, obstacles: int, seed: int, smoke: bool) -> dict[str, Any]:
    side = 8 if smoke else 20
    levels, steps, turns = (2, 2, 1) if smoke else (LEVELS, STEPS, 3)
    density = (obstacles + 0.5) / side**2
    options = {"num_rows": side, "num_cols": side, "num_agents": 4 if smoke else AGENTS, "obstacle_density": density}
    env = camar.camar_v0(map_generator=importlib.import_module("camar.maps").random_grid(**options))
    keys = jax.random.split(jax.random.key(seed), levels)
    states = jax.jit(jax.vmap(lambda key: env.reset(key)[1]))(keys)
    find = partial(_fields, env, 8 * obstacles)
    fields = jax.jit(jax.vmap(find))(states)
    ways: dict[str, Callable[..., Any]] = {
        "without": lambda state, field: jnp.zeros(()),
        "once a level": lambda state, field: _distances(field, state),
        "every step": lambda state, field: _distances(
            find(state.replace(landmark_pos=state.landmark_pos + 1e-12 * state.step)), state
        ),
    }
    rate, distances = {}, {}
    for way, measured in ways.items():

        def roll(state, field, key, measured=measured):
            def one(state, key):
                state = env.step(key, state, env.action_spaces.sample(key))[1]
                return state, (measured(state, field), state.physical_state.agent_pos)

            return jax.lax.scan(one, state, jax.random.split(key, steps))[1]

        # Building a map takes longer than CAMAR's step: fewer levels say how long.
        few = levels if way != "every step" else max(levels // 8, 1)
        arguments = jax.tree.map(lambda leaf: leaf[:few], (states, fields, keys))  # noqa: B023
        call, _ = compiled(jax.vmap(roll), *arguments)
        call(*arguments)
        rate[way] = few * steps / least(lambda: call(*arguments), turns).cpu  # noqa: B023
        distances[way] = call(*arguments)
    found, agents = (np.asarray(each)[:_CHECKED] for each in distances["once a level"])
    wrong, largest, num_infinite = _errors(env, 8 * obstacles, states, found, agents)
    again = np.asarray(distances["every step"][0])
    return {
        "discs": 8 * obstacles,
        "corners": 8 * obstacles * CORNERS,
        "steps_a_cpu_second": rate,
        "once_over_without": rate["once a level"] / rate["without"],
        "every_over_without": rate["every step"] / rate["without"],
        "checked": int(found.size),
        "wrong": wrong,
        "largest_error": largest,
        "infinite": num_infinite,
        "every_step_differs": int((found[: len(again)] != again).sum()),
    }


def _polygons(env: Any, discs: int, state: Any) -> Any:
    radius = env.map_generator.landmark_rad + env.map_generator.agent_rad
    return polygons_of_discs(state.landmark_pos[:discs], radius, CORNERS)


def _bounds(env: Any) -> np.ndarray:
    half = np.array([env.width, env.height]) / 2 - env.map_generator.landmark_rad
    return np.stack([-half, half]).astype(np.float32)


def _fields(env: Any, discs: int, state: Any) -> Any:
    """Return the distance to each agent's goal."""
    polygons = _polygons(env, discs, state)
    return jax.vmap(lambda goal: polygon_distance(polygons, goal, bounds=_bounds(env)))(state.goal_pos)


def _distances(fields: Any, state: Any) -> Any:
    return jax.vmap(lambda field, x: field(x))(fields, state.physical_state.agent_pos)


def _errors(env: Any, discs: int, states: Any, found: np.ndarray, agents: np.ndarray) -> tuple[int, float, int]:
    """Compare distances ``(levels, steps, agents)`` with the oracle; return wrong, largest error, infinite."""
    truth = np.empty(found.shape)
    bounds = _bounds(env).astype(float)
    for level in range(len(found)):
        state = jax.tree.map(lambda leaf: leaf[level], states)  # noqa: B023
        workspace = Workspace((bounds[0], bounds[1]), list(np.asarray(_polygons(env, discs, state), float)))
        for agent, goal in enumerate(np.asarray(state.goal_pos, float)):
            truth[level, :, agent] = VisibilityGraph(workspace, goal)(agents[level, :, agent].astype(float))
    is_finite = np.isfinite(truth) & np.isfinite(found)
    with np.errstate(invalid="ignore"):
        error = np.where(np.isinf(truth) & np.isinf(found), 0, np.abs(truth - found))
    allowed = ALLOWED * float(np.max(bounds[1] - bounds[0]))
    return int((~(error <= allowed)).sum()), float(error[is_finite].max()), int(np.isinf(truth).sum())
