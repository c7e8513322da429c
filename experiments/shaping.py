"""Does the true distance help an agent? PPO in random mazes, its reward shaped by potentials, or not at all.

Mazes are drawn inside ``jit``, one an episode (``environments/maze.py``). The potential is the negative distance to
the goal: the straight line, or the way around by ``grid_distance``, found once a maze inside ``jit``. All else is the
same: seeds, steps, networks. What a critic learns is the value less the potential: that of straight lines can be read
from what the agent sees, that of ways around it cannot, so there is also an agent whose critic, not its policy, is
told the potential. Success is the share of fixed fresh mazes whose goal is reached in time.
"""

import time
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Bool, Float, Int
from matplotlib.figure import Figure

from experiments._runner import Section, run
from experiments.environments.maze import (
    DISCOUNT,
    LIMIT,
    WEIGHT,
    Cell,
    Distance,
    Distances,
    Mask,
    State,
    observe,
    potential,
    reset,
    step,
)
from plr_jax import grid_distance

TARGET = 0.75
"""A success, the steps to which are told."""
_NUM_SEEDS = 5
_LEVELS_SEED = 1_000_000
_WIDTH = 64
_TRACE = 0.95
_CLIP = 0.2
_ENTROPY = 0.01
_RATE = 1e-3
_EPOCHS, _MINIBATCHES = 4, 4
_TURNS = 7


class Kind(NamedTuple):
    """What shapes the reward, and whether the critic is told of it."""

    distance: Distance
    is_told: bool = False


def none(free: Mask, goal: Cell) -> Distances:
    return jnp.zeros(free.shape)


def straight_line(free: Mask, goal: Cell) -> Distances:
    return jnp.linalg.norm(jnp.indices(free.shape) - goal[:, None, None], axis=0)


def way_around(free: Mask, goal: Cell) -> Distances:
    return grid_distance(free, goal[::-1] + 0.5, moves=4).cells


KINDS = {
    "not shaped": Kind(none),
    "straight line": Kind(straight_line),
    "grid_distance": Kind(way_around),
    "grid_distance, told to the critic": Kind(way_around, is_told=True),
}


class Size(NamedTuple):
    """How much is learned: environments, their steps an update, updates an evaluation, evaluations, their mazes."""

    environments: int = 64
    steps: int = 64
    updates: int = 12
    evaluations: int = 20
    mazes: int = 512


class Batch(NamedTuple):
    """Steps of all environments; what the critic is given is called known."""

    seen: Float[Array, "*steps features"]
    action: Int[Array, "*steps"]
    log_chance: Float[Array, "*steps"]
    reward: Float[Array, "*steps"]
    known: Float[Array, "*steps more"]
    known_after: Float[Array, "*steps more"]
    is_there: Bool[Array, "*steps"]
    is_over: Bool[Array, "*steps"]


# The agent: a network of its policy, and one of the value, its critic.


def new_agent(key: Array, features: int) -> dict[str, Any]:
    def network(key: Array, gain: float, *widths: int) -> list[tuple[Array, Array]]:
        shapes, gains = [*pairwise(widths)], (1.0, 1.0, gain)
        return [
            (gain * shape[0] ** -0.5 * jax.random.normal(key, shape), jnp.zeros(shape[1]))
            for key, gain, shape in zip(jax.random.split(key, 3), gains, shapes, strict=True)
        ]

    policy, value = jax.random.split(key)
    return {
        "policy": network(policy, 0.01, features, _WIDTH, _WIDTH, 4),
        "value": network(value, 1.0, features + 1, _WIDTH, _WIDTH, 1),
    }


def forward(layers: list[tuple[Array, Array]], x: Array) -> Array:
    *hidden, (weights, bias) = layers
    for each, shift in hidden:
        x = jnp.tanh(x @ each + shift)
    return x @ weights + bias


def log_chances(agent: Any, seen: Array) -> Array:
    return jax.nn.log_softmax(forward(agent["policy"], seen))


def value_of(agent: Any, known: Array) -> Array:
    return forward(agent["value"], known)[..., 0]


# Proximal policy optimization (Schulman et al., 2017).


def roll_out(agent: Any, states: State, key: Array, kind: Kind, steps: int) -> tuple[State, Batch]:
    """Steps of all environments; where an episode ends the next one begins."""
    known_to = jax.vmap(lambda state: jnp.append(observe(state), potential(state) if kind.is_told else 0.0))

    def advance(states, key):
        act_key, reset_key = jax.random.split(key)
        seen = jax.vmap(observe)(states)
        chances = log_chances(agent, seen)
        action = jax.random.categorical(act_key, chances)
        after, reward, is_there, is_late = jax.vmap(step)(states, action)
        is_over = is_there | is_late
        batch = Batch(
            seen, action, _of(chances, action), reward, known_to(states), known_to(after), is_there, is_over
        )
        fresh = new_mazes(reset_key, len(action), kind.distance)
        return jax.tree.map(partial(jax.vmap(jnp.where), is_over), fresh, after), batch

    return lax.scan(advance, states, jax.random.split(key, steps))


def new_mazes(key: Array, number: int, distance: Distance) -> State:
    return jax.vmap(partial(reset, distance=distance))(jax.random.split(key, number))


def _of(chances: Array, action: Array) -> Array:
    return jnp.take_along_axis(chances, action[..., None], -1)[..., 0]


def advantages(agent: Any, batch: Batch) -> Float[Array, "steps environments"]:
    """Generalized ones: there is nothing to gain past a goal, but there is past a limit of time."""
    later = value_of(agent, batch.known_after) * ~batch.is_there
    surprise = batch.reward + DISCOUNT * later - value_of(agent, batch.known)

    def backward(later, now):
        surprise, is_over = now
        advantage = surprise + DISCOUNT * _TRACE * later * ~is_over
        return advantage, advantage

    return lax.scan(backward, jnp.zeros(surprise.shape[1]), (surprise, batch.is_over), reverse=True)[1]


def loss(agent: Any, batch: Batch, advantage: Float[Array, " n"], value: Float[Array, " n"]) -> Float[Array, ""]:
    chances = log_chances(agent, batch.seen)
    ratio = jnp.exp(_of(chances, batch.action) - batch.log_chance)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - _CLIP, 1 + _CLIP) * advantage)
    entropy = -(jnp.exp(chances) * chances).sum(-1)
    return 0.5 * jnp.mean((value_of(agent, batch.known) - value) ** 2) - jnp.mean(gain + _ENTROPY * entropy)


def learn(key: Array, kind: Kind, size: Size) -> Float[Array, " evaluations"]:
    """Success of an agent as it learns."""
    optimizer = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(_RATE, eps=1e-5))
    agent_key, reset_key, key = jax.random.split(key, 3)
    states = new_mazes(reset_key, size.environments, kind.distance)
    agent = new_agent(agent_key, jax.vmap(observe)(states).shape[1])

    def update(learner, key):
        agent, memory, states = learner
        keys = jax.random.split(key, _EPOCHS + 1)
        states, batch = roll_out(agent, states, keys[0], kind, size.steps)
        advantage = advantages(agent, batch)
        every = batch, advantage, advantage + value_of(agent, batch.known)
        every = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), every)

        def improve(learned, rows):
            agent, memory = learned
            slope = jax.grad(loss)(agent, *jax.tree.map(lambda leaf: leaf[rows], every))
            change, memory = optimizer.update(slope, memory)
            return (optax.apply_updates(agent, change), memory), None

        shuffled = jax.vmap(jax.random.permutation, (0, None))(keys[1:], size.environments * size.steps)
        rows = shuffled.reshape(_EPOCHS * _MINIBATCHES, -1)
        (agent, memory), _ = lax.scan(improve, (agent, memory), rows)
        return (agent, memory, states), None

    def updates(learner, key):
        learner, _ = lax.scan(update, learner, jax.random.split(key, size.updates))
        return learner, success(learner[0], size.mazes)

    return lax.scan(updates, (agent, optimizer.init(agent), states), jax.random.split(key, size.evaluations))[1]


def success(agent: Any, mazes: int) -> Float[Array, ""]:
    """The share of mazes, the same ones always, whose goal is reached in time."""

    def advance(states, key):
        action = jax.random.categorical(key, log_chances(agent, jax.vmap(observe)(states)))
        states, _, is_there, _ = jax.vmap(step)(states, action)
        return states, is_there

    key = jax.random.key(_LEVELS_SEED)
    return lax.scan(advance, new_mazes(key, mazes, none), jax.random.split(key, LIMIT))[1].any(axis=0).mean()


# What is measured.


def learning(seed: int, smoke: bool) -> dict[str, Any]:
    size = Size(2, 8, 1, 2, 4) if smoke else Size()
    steps = size.environments * size.steps * size.updates * np.arange(1, size.evaluations + 1)
    rows = []
    for name, kind in list(KINDS.items())[-1:] if smoke else KINDS.items():
        learned = jax.jit(partial(learn, kind=kind, size=size))
        for each in range(_NUM_SEEDS * seed, _NUM_SEEDS * seed + (1 if smoke else _NUM_SEEDS)):
            curve = np.asarray(learned(jax.random.key(each)))
            print(f"{name}, seed {each}: {curve[-1]:.3f}", flush=True)
            first = next((int(at) for at in steps[curve >= TARGET]), None)
            rows.append({"kind": name, "seed": each, "steps_to_target": first, "success": curve.tolist()})
    return {
        "mazes": size.mazes,
        "detours": detours(size.mazes),
        "target": TARGET,
        "steps": steps.tolist(),
        "rows": rows,
    }


def detours(number: int) -> dict[str, Any]:
    """How far the goals of the mazes of :func:`success` are at first: around walls, and straight."""

    @jax.jit
    def at_start(key):
        states = (new_mazes(key, number, distance) for distance in (way_around, straight_line))
        return [-jax.vmap(potential)(each) / WEIGHT for each in states]

    around, straight = map(np.asarray, at_start(jax.random.key(_LEVELS_SEED)))
    ratio = float(np.mean(around / straight))
    return {"around": float(around.mean()), "straight": float(straight.mean()), "mean_ratio": ratio}


def speed(seed: int, smoke: bool) -> dict[str, Any]:
    """Steps a second, of agents that only act, for each step a maze is drawn, and that learn; all take turns."""
    size, turns = (Size(2, 8, 1, 1, 1), 1) if smoke else (Size(evaluations=1, mazes=1), _TURNS)
    key = jax.random.key(seed)
    number = size.environments * size.steps * size.updates
    calls = {}
    for name, kind in KINDS.items():
        states = new_mazes(key, size.environments, kind.distance)
        agent = new_agent(key, jax.vmap(observe)(states).shape[1])
        act = jax.jit(partial(roll_out, kind=kind, steps=size.steps * size.updates))
        calls[name, "acting"] = partial(act, agent, states, key)
        calls[name, "learning"] = partial(jax.jit(partial(learn, kind=kind, size=size)), key)
    seconds = {each: [] for each in calls}
    for _ in range(1 + turns):
        for each, call in calls.items():
            start = time.perf_counter()
            jax.block_until_ready(call())
            seconds[each].append(time.perf_counter() - start)
    rate = {each: number / float(np.median(runs[1:])) for each, runs in seconds.items()}  # the first one compiles
    return {"rows": [{"kind": name, "doing": doing, "steps_a_second": rate[name, doing]} for name, doing in rate]}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Of each kind the mean of its seeds, between the least and the largest."""
    figure = Figure(figsize=(7, 4.2), layout="constrained", facecolor="white")
    ax = figure.subplots()
    steps = np.array(results["steps"]) / 1e6
    for name, color in zip(KINDS, ("#777777", "#E69F00", "#D55E00", "#0072B2"), strict=True):
        curves = np.array([row["success"] for row in results["rows"] if row["kind"] == name])
        if len(curves):
            ax.fill_between(steps, curves.min(0), curves.max(0), color=color, alpha=0.2, lw=0)
            ax.plot(steps, curves.mean(0), color=color, label=name)
    ax.set(xlabel="steps (millions)", ylabel="fresh mazes solved", xlim=(0, None), ylim=(0, 1))
    ax.grid(True, color="#dddddd", lw=0.6)
    ax.legend(frameon=False, fontsize=9, loc="lower right")
    path = output / "shaping.png"
    figure.savefig(path, dpi=150)
    return [path]


SECTIONS = {"learning": Section(learning, draw), "speed": Section(speed)}

if __name__ == "__main__":
    run("shaping", __doc__, SECTIONS)
