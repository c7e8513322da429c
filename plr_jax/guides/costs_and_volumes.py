"""Guide: build a cost-to-go over cost maps, in voxels, or for rigid bodies and robot arms, without an oracle.

`plr_jax.solve_eikonal` needs only a *configuration space*, which says what is free, and a goal. With a *cost map*,
costs differ from place to place. The result is a `plr_jax.PLR`. To turn a raster of costs into a raster of distances,
use `plr_jax.cost_distance` instead.

```python
import numpy as np
import plr_jax

values = np.ones((40, 60))  # cost per unit of length, values[row, column]; row 0 is the lowest y
values[10:30, 20:40] = 3  # a swamp: each unit of length costs 3
values[15:25, 45:50] = np.inf  # blocked
cost = plr_jax.RasterCost(values, bounds=((0, 0), (6, 4)))
space, goal = cost.space(radius=0.1), (0.5, 2)
plr = plr_jax.solve_eikonal(space, goal, cost_map=cost, certified=False)
print(cost([[3, 2]]), plr([[5.5, 2]]))  # the cost per unit of length there; the cost of the best path
descent = plr_jax.descend(plr, space, [(5.5, 2)], goal, cost_map=cost)
print(descent.paths[0], descent.costs)  # a path that follows the PLR, and its cost
plr_jax.plot.plot_contours(plr, space=space, goal=goal)
exits = plr_jax.solve_eikonal(space, [(0.5, 2), (5.5, 3.5)], cost_map=cost, certified=False)
print(exits([[3, 2]]), exits.which([[3, 2]]))  # the cost to the nearest exit, and the index of that exit
```

- `certified=False`: an estimate in up to three dimensions. Mean errors: mostly below 0.5 %, in volumes 0.4 to 6 %.
- `certified=True`, the default, also proves bounds, `plr.bounds(x)`, and takes longer. Upper bounds are `inf` where
  no proven path was found, such as beside obstacles.
- Several goals are the rows of an array. Then `plr.which(x)` works only before saving, and not under `jit`.
- For tighter bounds, raise `max_leaves` above its default, 10,000 in the plane. `max_bytes` limits the file.

# Costs

A `plr_jax.spaces.CostMap` is a positive factor of the length of motions through `q`: for travel times, `1 / speed`.

- `plr_jax.RasterCost`: a raster of factors. `interpolation="bilinear"`, the default, suits samples of a smooth cost;
  `"nearest"` suits cells of classes, such as road and river. The two are different costs, with different true
  distances. `from_costmap` and `from_occupancy_grid` read ROS, `inflated` adds costs around obstacles like Nav2, and
  `plr_jax.scenes.read_cost_map` reads files.
- `plr_jax.spaces.LipschitzCost`: a function, and a limit of how fast it changes. Proofs rely on this limit.
- `plr_jax.spaces.DirectionalCost`: costs that depend on the direction, such as a current; its docstring has examples.
- `plr_jax.spaces.MotionCost`: how a space measures the length of a motion, for example with a weight for turns.

```python
slow = plr_jax.spaces.LipschitzCost(lambda q: 1 + q[:, 0], lipschitz=1, least=1)
plane = plr_jax.PlaneSpace(plr_jax.scenes.maze().workspace)  # a point; a second argument may be a DiscRobot
proven = plr_jax.solve_eikonal(plane, goal=(0.06, 0.07), cost_map=slow, max_bytes=8192)
lower, upper = proven.bounds([[0.9, 0.9]])
print(slow([[0.5, 0.5]]), lower, proven([[0.9, 0.9]]), upper)
```

# Compare with a grid solver

Give a grid solver the `cost` at its nodes, not `values`, with at least 8 nodes along a side of a cell. Start it on a
circle around the goal, not at the goal, where grid solvers have large errors. Inside the circle, the cost must be 1.

```python
import skfmm

x, y = np.meshgrid(np.arange(0.00625, 6, 0.0125), np.arange(0.00625, 4, 0.0125))  # 8 nodes along a side
nodes = np.stack([x.ravel(), y.ravel()], axis=1)
ring = np.ma.array(np.hypot(x - 0.5, y - 2) - 0.2, mask=~space.is_free(nodes).reshape(x.shape))  # 0 on the circle
marched = 0.2 + np.sign(ring) * skfmm.travel_time(ring, 1 / cost(nodes).reshape(x.shape), dx=0.0125)
truth = plr_jax.GridField(marched.filled(np.inf), bounds=((0, 0), (6, 4)))
print(plr_jax.metrics.error_map(plr, truth, nodes[space.is_free(nodes)][::100]))
```

# Volumes

Voxels are `free[x, y, z]`, rasters `[row, column]`. `scenes.read_volume` reads files; trimesh voxelizes meshes.

```python
free = np.ones((12, 12, 8), bool)
free[6, :9] = False
volume = plr_jax.VoxelSpace(free, radius=0.4)  # for a ball; radius 0 is a point
to_goal = plr_jax.solve_eikonal(volume, goal=(2, 2, 2), max_leaves=300, certified=False)
graph = plr_jax.VoxelGraph(free, goal=(2.5, 2.5, 2.5), moves=26)  # lengths from voxel to voxel
print(to_goal([[10.5, 2.5, 2.5]]), graph([[10.5, 2.5, 2.5]]))
```

# Bodies, arms, and any robot with a clearance

- `plr_jax.RigidBodySpace`: position and heading of a rectangle or polygon.
- `plr_jax.PlanarArm`: joint angles of an arm.
- `plr_jax.ClearanceSpace`: any robot with a signed distance to obstacles, and a Lipschitz constant for each axis.

```python
hall = plr_jax.Workspace(((0, 0), (4, 3)), [[(1.8, 0), (2.2, 0), (2.2, 1.2), (1.8, 1.2)]])
body = plr_jax.RigidBodySpace(hall, plr_jax.RectangleRobot(0.8, 0.3))
body_plr = plr_jax.solve_eikonal(body, goal=(0.6, 0.5, 0), max_leaves=500, certified=False)

arm = plr_jax.PlanarArm(hall, lengths=(0.8, 0.6), base=(0.9, 1.5), width=0.05)
arm_plr = plr_jax.solve_eikonal(arm, goal=(0, 0.5), max_leaves=500)

def clearance(q):  # of a ball of radius 0.2 beside a sphere of radius 0.8
    return np.linalg.norm(q - (2, 1, 1), axis=1) - 1

ball = plr_jax.ClearanceSpace(((0, 0, 0), (4, 3, 3)), clearance, lipschitz=1)
ball_plr = plr_jax.solve_eikonal(ball, goal=(0.2, 2.5, 2.5), max_leaves=2000)
print(body_plr((3.4, 0.5, 0)), arm_plr((2, 0)), ball_plr((3.8, 0.5, 0.5)), ball_plr.bounds((3.8, 0.5, 0.5)))
```

# Your own space

A class with `domain`, `motion_cost` and `is_free(q)` is a `plr_jax.spaces.FreeTest`: enough for an estimate.

```python
class Pipe:  # the surface of a pipe: a length and an angle, with a hole
    domain = plr_jax.Box((0, -np.pi), (10, np.pi), periodic=(False, True))
    motion_cost = plr_jax.spaces.MotionCost([((0, 1), 1.0)])  # Euclidean length over both axes, for a radius of 1

    def is_free(self, q):
        return np.hypot(q[:, 0] - 5, q[:, 1]) >= 1

pipe_plr = plr_jax.solve_eikonal(Pipe(), goal=(1, 0), max_leaves=500, certified=False)
print(pipe_plr((9, 0)), pipe_plr((9, 3)))
```

Proofs need a `plr_jax.spaces.ConfigurationSpace`: `classify(lo, hi)` returns a `plr_jax.spaces.CellState` for each
box, and `are_free(q0, q1)` tests motions. It must answer FREE or BLOCKED only where that is proven, else MIXED. With
`sees_boxes`, a `plr_jax.spaces.SeesBoxes`, upper bounds are finite beside walls too, except near the ends of walls.
"""
