"""Options that several commands share."""

from typing import Annotated

import typer

ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="A Ray cluster instead of --jobs: local (started here), auto (this machine's) or an"
        " address.",
    ),
]
