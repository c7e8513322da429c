"""What points of free space see: its triangulation, expansion over the triangles, and the table of what it finds."""

from plr_jax.geometry.visibility.expansion import Viewpoints as Viewpoints
from plr_jax.geometry.visibility.expansion import triangles_within as triangles_within
from plr_jax.geometry.visibility.table import VisibilityTable as VisibilityTable
from plr_jax.geometry.visibility.table import joined_tables as joined_tables
from plr_jax.geometry.visibility.table import visibility_of as visibility_of
from plr_jax.geometry.visibility.triangulation import Triangulation as Triangulation
from plr_jax.geometry.visibility.triangulation import triangulation_of as triangulation_of
