"""``figures``: draw the figures of a sweep."""

from __future__ import annotations

from fl3d.commands.parsing import HELP, parser
from fl3d.config.places import PUBLISHED
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Draw the figures of a sweep, without training anything; those of windows run its last and best models.

    Curves for any sweep: AP over steps, levels and score cut, precision over recall; with the figures of the papers
    that it feeds. What the models say of the validation frames' windows is kept in the store, so a second time is
    quick. Without a sweep among the words: of +sweep=gamma.
    """
    arguments_of = parser("figures", run.__doc__, "+sweep=gamma")
    arguments_of.add_argument("overrides", nargs="*", help=HELP)
    words = arguments_of.parse_intermixed_args(arguments).overrides
    with loading():
        from fl3d.analysis.contributions import Contributions
        from fl3d.api.words import open_words, or_gamma, read_words
        from fl3d.papers.drawings import draw_curves, draw_papers, draw_verdicts
        from fl3d.papers.stored import feeding
        from fl3d.papers.views import judge_or_say

    sweep = open_words(read_words(or_gamma(words)))
    written = []
    for one in (sweep, *sweep.each_class()):
        made = Contributions(one)
        judged = judge_or_say(one, print, made)
        written += [] if judged is None else draw_verdicts(one, judged)
        written += draw_curves(one, made)
    written += draw_papers(sweep, feeding(sweep, words, PUBLISHED))
    folder = sweep.settings.results_folder / "figures"
    print(f"Written to {folder}: " + ", ".join(path.name for path in written))
