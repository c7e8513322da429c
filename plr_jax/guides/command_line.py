"""Guide: build, query, view and export distance functions, and plan, with the command `plr-jax`.

`plr-jax --help` lists the commands, and `plr-jax build --help` lists the options of `build`. If the script is not on
the `PATH`, use `python -m plr_jax`.

```sh
plr-jax build maze --max-bytes 8192 --output maze.plr
plr-jax info maze.plr
echo "0.93,0.95" | plr-jax query maze.plr -
echo "0.93,0.95" | plr-jax query maze.plr - --bounds
plr-jax build maze --goal 0.06,0.07 --goal 0.9,0.1 --leaf cone --output exits.plr
echo "0.93,0.95" | plr-jax query exits.plr - --which
plr-jax plot maze.plr --output maze.png
plr-jax view maze.plr --output maze.html
plr-jax export maze.plr --c --output maze.h
plr-jax export maze.plr --js --output maze.mjs
plr-jax plan four_rooms --robots 2 --output path.json --animation path.html
```

# What each command does

- `build MAP` computes the exact distance to a goal and compresses it. `MAP` is one of the scenes `maze`, `thin_maze`
  and `floor_plan`, or a file that `plr_jax.scenes.read_workspace` reads, such as a picture, YAML of `map_server`,
  or GeoJSON. A file needs `--goal X,Y`, unless it is a scene of one robot; several goals give the distance to the
  nearest, for example to exits. The output has proven bounds; `--leaf-bounds` proves tighter ones for each leaf.
  `--leaf best`, the default, chooses a leaf model. `--max-bytes` limits the file; for a small largest error, give
  `--tolerance` instead.
- `info FILE` prints what is in a file: size, leaves, domain, proven error.
- `query FILE POINTS.csv` prints one distance for each line `x,y`; `-` is standard input. A point outside the
  domain gets `inf`, a line that is no point gets `nan` and a warning. `--bounds` adds proven bounds, and `--which`
  the index of the nearest goal, for files of cones and several goals. For pairs, lines are `x,y,x,y`.
- `plot FILE` draws a picture, `view FILE` writes a page for a browser that needs no network. Both draw the walls of
  the map that the file was built from. If the file of the map has moved, name it: `--map scan.png` of `plot`, or the
  argument MAP of `view`. The map is read with the options that the PLR was built with.
- `export FILE` writes C99 (`--c`) or JavaScript (`--js`), and prints how much memory C code takes: see
  `plr_jax.guides.c_and_javascript`.
- `plan SCENE` plans for all robots of a scene, checks the path, and exits with code 1 if no path was found. `SCENE`
  is a name or a file, such as `rooms.json`, that `plr_jax.scenes.save(problem, "rooms.json")` writes. To choose a
  heuristic, or options that the command does not have, call `plr_jax.bl_plan` in Python.
- `demo --output FOLDER` builds a maze, compares it with the exact distance, plans for four rooms, and draws both.

# From a picture to C

A scanned floor plan has a scale, gray levels, and specks. These options of `build` say how to read it:

- `--resolution` is the side of a pixel in workspace units. `--goal` is in workspace units too. Without
  `--resolution`, workspace units are pixels.
- `--drop-specks N` removes obstacles of at most `N` pixels, then free regions of at most `N` pixels.
- `--threshold` is the lightness above which a pixel is free: at least 0 (black) and below 1 (white), by default 0.5.
- `--radius` is the radius of a round robot; distances are then distances of its center.

Two approximations are made before the error is proven. Polygons replace the pixels, which may move outlines by half a
pixel. With `--radius`, obstacles grow, and polygons inscribed in their round corners replace the arcs. The proven
error is the error on the resulting map, not on the picture. The domain of the file is the part of the picture that
contains free space.

```python
import numpy as np
from PIL import Image

picture = np.full((60, 80), 255, np.uint8)  # 8-bit gray, white is free
picture[20:40, 30:50] = 0
Image.fromarray(picture).save("scan.png")
```

```sh
plr-jax build scan.png --goal 0.5,0.5 --resolution 0.05 --radius 0.1 --max-bytes 1024 --output scan.plr
plr-jax export scan.plr --c --output scan.h
```

In Python, `plr_jax.scenes.read_workspace("scan.png", resolution=0.05)` reads an equal map. The origin is the
lower left corner of the picture, and `y` points up.
"""
