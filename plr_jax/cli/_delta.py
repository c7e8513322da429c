"""The commands that send a PLR to whoever has another one: diff, patch."""

from pathlib import Path
from typing import Annotated

import typer

from plr_jax.cli._app import command
from plr_jax.cli._inputs import require_writable

OldArgument = Annotated[
    Path, typer.Argument(metavar="OLD", help="The file that is to be patched.", show_default=False)
]


@command("plr-jax diff maze.plr new_maze.plr -o maze.delta")
def diff(
    old: OldArgument,
    new: Annotated[Path, typer.Argument(metavar="NEW", help="The file to make of it.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", help="The delta to write.", show_default=False)],
) -> None:
    """Say what has changed from one PLR to another, of cones in few bytes; of other leaves it is the whole file."""
    from plr_jax._atomic import write_atomically
    from plr_jax.plr import load_numpy
    from plr_jax.plr.delta.file_delta import delta_of_files

    require_writable(output, inputs=(old, new))
    before, after = (load_numpy(path).to_bytes() for path in (old, new))
    delta = delta_of_files(before, after)
    write_atomically(output, delta)
    typer.echo(f"wrote {output}: {len(delta):,} bytes, of a file of {len(after):,}")


@command("plr-jax patch maze.plr maze.delta -o new_maze.plr")
def patch(
    old: OldArgument,
    delta: Annotated[Path, typer.Argument(metavar="DELTA", help="What diff wrote.", show_default=False)],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write; it may be OLD.", show_default=False)
    ],
) -> None:
    """Make the new file of the old one, byte for byte; a delta of another file is refused. JAX is not needed."""
    from plr_jax._atomic import write_atomically
    from plr_jax.plr import load_numpy
    from plr_jax.plr.file.container import MOST_BYTES

    require_writable(output, inputs=(delta,))
    with open(delta, "rb") as file:
        data = file.read(MOST_BYTES + 1)
    try:
        made = load_numpy(old).patched(data).to_bytes()
    except ValueError as error:
        raise ValueError(f"{old} cannot be patched with {delta}. {error}") from error
    write_atomically(output, made)
    typer.echo(f"wrote {output}: {len(made):,} bytes")
