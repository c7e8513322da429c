"""Helpers for tests of grids: grids drawn as text, all pairs of cells, many small random grids in one."""

import heapq
import math

import numpy as np


def drawn(*rows):
    """Return a grid drawn as text, with dots for free cells."""
    return np.array([[letter == "." for letter in row] for row in rows])


def published_queries(path):
    """Return the starts, goals and octile lengths of a ``.scen`` file of Moving AI."""
    table = np.loadtxt(path, skiprows=1, usecols=range(4, 9))
    return table[:, :2], table[:, 2:4], table[:, 4]


def all_pairs(free):
    """Return every pair of a free cell and any cell, as points."""
    cells = np.argwhere(np.ones_like(free))[:, ::-1].astype(float)
    starts = np.argwhere(free)[:, ::-1].astype(float)
    return np.repeat(starts, len(cells), axis=0), np.tile(cells, (len(starts), 1))


def mosaic(seed, tiles, size):
    """Return ``tiles`` x ``tiles`` random grids of random density, side by side with walls between."""
    rng = np.random.default_rng(seed)
    free = np.zeros((tiles * (size + 1), tiles * (size + 1)), bool)
    for row, column in np.ndindex(tiles, tiles):
        at = slice(row * (size + 1), row * (size + 1) + size), slice(column * (size + 1), column * (size + 1) + size)
        free[at] = rng.random((size, size)) > rng.choice([0.04, 0.1, 0.2, 0.35, 0.5])
    return free


def pairs_of_tiles(tiles, size):
    """Return all pairs of cells that lie in the same grid of a mosaic."""
    cells = np.argwhere(np.ones((size, size)))
    corners = np.argwhere(np.ones((tiles, tiles))) * (size + 1)
    x, y = np.repeat(cells, len(cells), axis=0), np.tile(cells, (len(cells), 1))
    return tuple((corners[:, None] + one).reshape(-1, 2)[:, ::-1].astype(float) for one in (x, y))


def dijkstra(free, start, connectivity):
    """Return distances of every cell from a start, by a textbook implementation."""
    distance = np.full(free.shape, np.inf)
    heap = [(0.0, start)] if free[start] else []
    while heap:
        length, (row, column) = heapq.heappop(heap)
        if distance[row, column] <= length:
            continue
        distance[row, column] = length
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                if (down or right) and legal(free, row, column, down, right, connectivity):
                    heapq.heappush(heap, (length + math.hypot(down, right), (row + down, column + right)))
    return distance


def legal(free, row, column, down, right, connectivity):
    """Return whether a step leads to a free cell and cuts no corner."""
    if down and right and connectivity == 4:
        return False
    cells = [(row + down, column + right), (row + down, column), (row, column + right)]
    return all(0 <= r < free.shape[0] and 0 <= c < free.shape[1] and free[r, c] for r, c in cells)
