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

/* Go from x to `next`, and look ahead for another waypoint, the next one. Return 0 if there is none. */
static int arrive(float x[2], float next[2])
{
    const float at[2] = {next[0], next[1]};
    for (float step = 1e-3f; next[0] == at[0] && next[1] == at[1] && step < 1e6f; step *= 2) {
        const float ahead[2] = {at[0] + step * (at[0] - x[0]), at[1] + step * (at[1] - x[1])};
        maze_waypoint(ahead, next);
    }
    x[0] = at[0], x[1] = at[1];
    return next[0] != at[0] || next[1] != at[1];
}

int main(void)
{
    float x[2] = {0.93f, 0.95f}, next[2];
    maze_waypoint(x, next);
    printf("%f, by way of (%f, %f)\n", maze_distance(x), next[0], next[1]);
    while (maze_distance(next) > 1e-5f && arrive(x, next)) /* until `next` is the goal */
        printf("then (%f, %f)\n", next[0], next[1]);
}
```

```text
cc -std=c99 -O2 -ffp-contract=off main.c -lm
```

At a corner, the waypoint may be the corner itself: so `arrive` looks ahead, in growing steps. In a maze (1 KB) and a
hall of shelves (2 KB), all paths arrive. If leaves exceed the map's details, paths cut corners: use more bytes.

## Small machines

`plr-jax build` and `export` print what the C code takes on a Cortex-M4; a comment in the header says it too. Headers
of tables, the default, add 600 bytes of code and 100 of stack; for compact headers, see the last row. In the plane:

| | plane | cone | continuous | smooth |
| --- | --: | --: | --: | --: |
| tables: bytes for each byte of the file, up to | 6 | 8 | 16 | 46 |
| with `compact=True` or `--compact`, up to | 1.7 | 2.6 | 2.6 | 3.3 |
| compact: bytes of code; of stack | 4,300; 600 | 1,400; 500 | 3,700; 800 | 6,500; 5,600 |

For 16 KB of flash, use cones: a file of 2 KB as tables, or 5 KB compact. Of compact headers, only those of cones
compute without doubles. A compact query takes 0.07 to 0.2 microseconds on a PC, with smooth leaves 1.7.

- `-fno-math-errno` makes `sqrtf` one instruction. Without it, a library may add 1 KB of RAM.
- Include a header in one source file only: each file that includes it gets tables of its own.
- Without float hardware (Cortex-M0), add 4 KB of code, 9 KB with doubles. On AVR, tables are in RAM; no compact code.
- Small files need few corners. Grow obstacles by Shapely's `buffer(radius, join_style="mitre")`: 27 shelves have 112
  corners, and errors below 0.1 m in 2 KB. With round corners of `--radius` and `workspace.inflate`, they have 868 or
  more, and errors of up to 3.5 m: walls hide waypoints.

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

Distances between any two points have modules and headers, too: see `plr_jax.guides.any_two_points`.
"""
