"""``verify``: whether the store's digits come out again."""

from __future__ import annotations

from fl3d.commands.parsing import HELP, parser
from fl3d.core.errors import StoreError
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Score a sweep's stored checkpoints again and compare every digit with the store."""
    arguments_of = parser("verify", run.__doc__)
    arguments_of.add_argument("overrides", nargs="*", help=f"{HELP} (default: +sweep=gamma)")
    arguments_of.add_argument(
        "--from-weights", action="store_true", help="run networks too, where weights are kept"
    )
    given = arguments_of.parse_intermixed_args(arguments)
    with loading():
        from fl3d.analysis.verify import verify
        from fl3d.api.words import open_words, or_gamma, read_words

    sweep = open_words(read_words(or_gamma(given.overrides)))
    found = verify(sweep, given.from_weights)
    if found.wrong:
        count = f"{len(found.wrong)} of {found.checkpoints} checkpoints could not be reproduced"
        raise StoreError("\n".join([f"{count}:", *found.wrong]))
    name = sweep.settings.experiment
    print(
        f"{found.checkpoints} checkpoints of {name}, {found.metrics} APs each: every digit was reproduced"
    )
    if given.from_weights:
        print(
            f"{found.from_weights} of them from their weights; the weights of the others were not kept"
        )
