"""Arguments and options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from plr_jax.cli._inputs import SCENES

_READING = "How MAP is read"

MapArgument = Annotated[
    str,
    typer.Argument(
        metavar="MAP",
        help=f"A scene ({', '.join(SCENES)}) or a file: a picture (.png, .pgm, ...), a map of map_server (.yaml), "
        "GeoJSON (.geojson, .json), a Moving AI grid (.map), polygons with holes (.json), a scene (.json).",
        show_default=False,
    ),
]
ResolutionOption = Annotated[
    float | None,
    typer.Option(
        help="Side of a pixel of a picture, in workspace units.", show_default="1", rich_help_panel=_READING
    ),
]
ThresholdOption = Annotated[
    float | None,
    typer.Option(
        help="Lightness above which a pixel of a picture is free: 0 is black, 1 white.",
        show_default="0.5",
        rich_help_panel=_READING,
    ),
]
DropSpecksOption = Annotated[
    int | None,
    typer.Option(
        help="Drop obstacles, and places to be, of at most so many pixels.",
        show_default="0",
        rich_help_panel=_READING,
    ),
]
PolygonsOption = Annotated[
    str | None,
    typer.Option(
        help="What polygons of GeoJSON are: 'obstacles' or 'free'.",
        show_default="obstacles",
        rich_help_panel=_READING,
    ),
]
FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A .plr file.", show_default=False)]
GoalOption = Annotated[
    str | None,
    typer.Option(
        "--goal", "-g", metavar="X,Y", help="The goal; a scene of one robot brings its own.", show_default=False
    ),
]
