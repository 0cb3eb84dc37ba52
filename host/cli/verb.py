"""A verb of `host usd` or `host sync`: what all of them have."""

from __future__ import annotations

import argparse
from typing import Any


def add_verb(
    verbs: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    run: Any,
    says: str,
    examples: str,
    more: str = "",
) -> argparse.ArgumentParser:
    """`more`: what its help says besides."""
    verb = verbs.add_parser(
        name,
        help=says,
        description=f"{says[0].upper()}{says[1:]}.{more}",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verb.add_argument("--json", action="store_true", help="JSON lines on stdout")
    verb.set_defaults(run=run)
    return verb
