r"""Guide: query a distance function without JAX, in NumPy, C, C++ or JavaScript.

The file format defines the arithmetic of a query. So the code in all these languages gives the same answers, bit for
bit, as `plr.numpy()`, and as `plr(x)` on a CPU in 32 bits (except for numbers below 1e-38). NumPy takes batches of
points; C and JavaScript take single points. The C code does not compute bounds. `plr_jax.load_numpy` returns a
`plr_jax.plr.NumpyPLR`, without JAX; a single point takes a few microseconds.

```python
from pathlib import Path

import plr_jax

problem = plr_jax.scenes.maze()
oracle = plr_jax.VisibilityGraph(problem.workspace, problem.goals[0])
plr = plr_jax.construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=1024, certified=True)
plr_jax.save(plr, "maze.plr")

f = plr_jax.load_numpy("maze.plr")  # or plr.numpy()
print(f((0.93, 0.95)), f.bounds((0.93, 0.95)), f.waypoint((0.93, 0.95)), f.max_error)
Path("maze.h").write_text(plr.c_header("maze"))
Path("small.h").write_text(plr.c_header("small", compact=True))
Path("other.bin").write_bytes(plr.c_bytes())
Path("maze.mjs").write_text(plr.js_module())
```

# C and C++

The header is C99, also valid C++. It allocates nothing and calls no library function except `sqrtf`; compact headers
also call `memcpy` and `memset`. It defines `float maze_distance(const float x[2])`, which is `INFINITY` outside the
domain and NaN for NaN. For cones it also defines `void maze_waypoint(const float x[2], float waypoint[2])`: the point
to go to next. Other leaves have no waypoints: build with `leaf="cone"` or `--leaf cone`, for maps of polygons.

In a domain far from the origin, such as UTM coordinates, `x` is `double`. Compile with `-ffp-contract=off`: fused
operations change the last bits. With `-m32`, x87 registers do, too: an `#error` asks for `-msse2 -mfpmath=sse`.

```c
#include <stdio.h>
#include "maze.h"

int main(void)
{
    const float x[2] = {0.93f, 0.95f};
    float next[2];
    maze_waypoint(x, next);
    printf("%f, by way of (%f, %f)\n", maze_distance(x), next[0], next[1]);
}
```

```text
cc -std=c99 -O2 -ffp-contract=off main.c -lm
```

## Small machines

`plr-jax build` and `export` print what the C code takes on a Cortex-M4; a comment in the header says it too. Typical
values in the plane, to which tables without `compact=True` add 600 bytes of code and 100 of stack:

| | plane | cone | continuous | smooth |
| --- | --: | --: | --: | --: |
| tables, times the size of the file | 4 | 7 | 15 | 45 |
| the same with `compact=True` or `--compact` | 1.3 | 2.2 | 2.3 | 3 |
| compact: bytes of code; of stack | 4,300; 600 | 1,400; 500 | 3,700; 800 | 6,500; 5,600 |

For 16 KB of flash, use cones: a file of 2 KB as tables, or 5 KB compact. Other compact leaves compute with doubles.
A compact query takes 0.07 to 0.2 microseconds on a PC, with smooth leaves 1.7.

- `-fno-math-errno` makes `sqrtf` one instruction. Without it, a library may add 1 KB of RAM.
- Include a header in one source file only: each file that includes it gets tables of its own.
- Without float hardware (Cortex-M0), add 4 KB of code, 9 KB with doubles. On AVR, tables are in RAM; no compact code.
- A waypoint is a corner or the goal. On a corner, it may be that corner: go one more step ahead, then ask again.
- In small files, a wall may hide the waypoint: `--radius` grows obstacles by the robot's radius.

Compact headers share a decoder, which can also query bytes that a robot receives. If `plr_jax_open` accepts damaged
bytes, answers may be wrong, but no query reads outside of these bytes.

```c
#include <stdio.h>
#include "small.h"

int main(void)
{
    static unsigned char received[8192];
    struct plr_jax other;
    const float x[2] = {0.93f, 0.95f};
    float next[2];
    uint32_t size = (uint32_t)fread(received, 1, sizeof received, fopen("other.bin", "rb"));
    if (plr_jax_open(&other, received, size) || plr_jax_dim(&other) != 2 || plr_jax_is_far(&other))
        return 1; /* damaged, or not for points of two floats */
    plr_jax_waypoint(&other, x, next);
    printf("%f, by way of (%f, %f)\n", small_distance(x), next[0], next[1]);
}
```

# JavaScript

The module exports `distance(x)`, for cones `waypoint(x)`, and for a certified PLR `bounds(x)`, `[lower, upper]`:

```js
import { bounds, distance, waypoint } from "./maze.mjs";
console.log(distance([0.93, 0.95]), bounds([0.93, 0.95]), waypoint([0.93, 0.95]));
```

# Pairs

The module of a `plr_jax.PairPLR` exports `distance(x, y)`, `waypoint(x, y)` and `bounds(x, y)`. In C, use
`pairs.to(goal)`, the distance to one goal. The header of a `plr_jax.GridPairs` defines
`int32_t grid_steps(uint32_t from, uint32_t to)`, which reads tables from a separate file, with bytes `header.table`.

```python
import numpy as np

pairs = plr_jax.construct_pairs(problem.workspace, max_bytes=1024)
Path("pairs.mjs").write_text(pairs.js_module())
Path("to_goal.h").write_text(pairs.to((0.06, 0.07)).c_header("to_goal"))

grid = plr_jax.construct_grid_pairs(np.ones((8, 8), bool))
header = grid.c_header("grid")
Path("grid.h").write_text(header.text)
Path("grid.tables").write_bytes(header.table)
```
"""
