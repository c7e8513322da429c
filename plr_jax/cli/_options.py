"""Arguments and options that several commands have."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from plr_jax.cli._inputs import SCENES

MapArgument = Annotated[
    str,
    typer.Argument(
        metavar="MAP",
        help=f"A scene ({', '.join(SCENES)}) or a file: a picture (.png, .pgm, ...), a map of map_server (.yaml), "
        'of which costs do not count, GeoJSON (.geojson, .json; bounded by its "bbox", or else by its polygons), a '
        "Moving AI grid (.map), "
        "polygons with holes (.json), a scene (.json); build also takes volumes: an array (.npy), True where it is "
        "free, voxels of Moving AI (.3dmap), a mesh (.stl, .obj, .ply).",
        show_default=False,
        autocompletion=lambda: list(SCENES),
    ),
]


def _of_reading(told: str, default: str, **others: Any) -> Any:
    """An option of how MAP is read."""
    return typer.Option(help=told, show_default=default, rich_help_panel="How MAP is read", **others)


def one_of(names: Sequence[str]) -> dict[str, Any]:
    """An option of which the help shows the choices, and the shell completes them."""
    return {"metavar": f"[{'|'.join(names)}]", "autocompletion": lambda: list(names)}


ResolutionOption = Annotated[
    float | None, _of_reading("Side of a pixel of a picture or of a voxel, in workspace units; a mesh needs it.", "1")
]
ThresholdOption = Annotated[
    float | None, _of_reading("Lightness above which a pixel of a picture is free: 0 is black, 1 white.", "0.5")
]
DropSpecksOption = Annotated[
    int | None, _of_reading("Drop obstacles, and places to be, of at most so many pixels.", "0")
]
PolygonsOption = Annotated[
    str | None, _of_reading("What polygons of GeoJSON are.", "obstacles", **one_of(("obstacles", "free")))
]
BoxOption = Annotated[
    str | None,
    _of_reading(
        "Of a volume, the corners of the box that its voxels fill.",
        "from 0 on with voxels as --resolution says, or the mesh's own",
        metavar="X,Y,Z,X,Y,Z",
    ),
]
EnclosedOption = Annotated[
    str | None, _of_reading("What the surface of a mesh encloses is.", "blocked", **one_of(("blocked", "free")))
]
RadiusOption = Annotated[
    float | None,
    _of_reading("Radius of a round robot, in workspace units: distances are of its center.", "that of a point: 0"),
]
FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A file of a PLR, or of pairs.", show_default=False)
]
GoalOfPairsOption = Annotated[
    str | None,
    typer.Option("--goal", "-g", metavar="X,Y", help="Of pairs, or of the map, the goal.", show_default=False),
]
GoalOption = Annotated[
    str | None,
    typer.Option(
        "--goal",
        "-g",
        metavar="X,Y",
        help="The goal, of a volume X,Y,Z; a scene of one robot brings its own.",
        show_default=False,
    ),
]
